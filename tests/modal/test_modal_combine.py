"""Several recordings as one: realisations, references, sweeps with zooms; and what does not go together."""

from dataclasses import replace

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.modal.combine import combine_responses
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.poles import estimate_poles

FREQ, ZETA = np.array([9.618, 9.629]), np.array([0.010, 0.004])
"""Two modes 0.1 % apart whose peaks are ten times wider, as those of the grid."""
PHI = np.array([[0.68, -0.19], [-0.44, -0.13], [0.2, 0.74], [-0.46, -0.51], [-0.36, 0.36]])


def response(freq, inputs, *, seed=0, noise=0.0):
    s, omega = 2j * np.pi * np.asarray(freq)[:, None], 2 * np.pi * FREQ
    columns = [int(name[1:]) for name in inputs]
    H = np.einsum("fk,ok,ik->foi", 1 / (s**2 + 2 * ZETA * omega * s + omega**2), PHI, PHI[columns])
    rng = np.random.default_rng(seed)
    sd = noise * np.sqrt(np.mean(np.abs(H) ** 2))
    H = H + sd * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return MeasuredFrequencyResponse(
        freq=freq,
        H=H,
        outputs=tuple("abcde"),
        inputs=tuple(inputs),
        variance=np.full(H.shape, sd**2 + 1e-30),
        coherence=np.ones(H.shape[:2]),
        n_averages=4.0,
    )


LINES = np.arange(900, 1050) / 100


def test_two_references_tell_modes_apart_that_one_mixes():
    def errors(parts):
        found = estimate_poles(combine_responses(parts), n_modes=2)
        return np.abs(found.zeta / ZETA[np.argsort(FREQ)] - 1).max(), found

    both, found = errors([response(LINES, ["f0"], seed=1, noise=0.01), response(LINES, ["f2"], seed=2, noise=0.01)])
    assert found.freq == pytest.approx(FREQ, rel=1e-4)
    assert both < 0.02
    shapes = found.real_shapes()
    for k in range(2):
        alike = (shapes[:, k] @ PHI[:, k]) ** 2 / (shapes[:, k] @ shapes[:, k]) / (PHI[:, k] @ PHI[:, k])
        assert alike > 0.999


def test_realisations_are_averaged_and_their_spread_counts():
    quiet = [response(LINES, ["f0"], seed=k, noise=0.02) for k in range(8)]
    mean = combine_responses(quiet)
    exact = response(LINES, ["f0"])
    assert np.sqrt(np.mean(np.abs(mean.H - exact.H) ** 2)) == pytest.approx(np.sqrt(mean.variance.mean()), rel=0.1)
    # the stated variance is ten times too small: the spread between the realisations says so
    loud = combine_responses([replace(r, variance=r.variance / 10) for r in quiet])
    assert loud.variance.mean() == pytest.approx(mean.variance.mean(), rel=0.25)


def test_a_sweep_and_its_zoom_become_one():
    coarse, fine = np.array([9.0, 9.333, 9.7, 10.1]), np.array([9.55, 9.59, 9.61, 9.64, 9.7])
    joined = combine_responses([response(coarse, ["f0"]), response(fine, ["f0"])])
    assert joined.freq.tolist() == sorted(set(coarse) | set(fine))
    assert pytest.approx(response(joined.freq, ["f0"]).H) == joined.H


def test_what_does_not_go_together_is_refused():
    a = response(LINES, ["f0"])
    with pytest.raises(BadRecording, match="few frequency lines in common"):
        combine_responses([a, response(LINES + 2.0, ["f1"])])
    with pytest.raises(BadRecording, match="no common average"):
        combine_responses([a, response(np.arange(450, 525) / 50, ["f0"])])
    with pytest.raises(BadRecording, match="outputs or windows"):
        combine_responses([a, replace(a, added_decay=0.1)])
    with pytest.raises(BadRecording, match="stands alone and among others"):
        combine_responses([a, response(LINES, ["f0", "f1"])])
