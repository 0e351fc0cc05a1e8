"""Combination of responses: averages, sweeps with zooms, several inputs."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from vlab.errors import BadRecording
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.steps import merged
from vlab.signals import Array

IN_COMMON = 0.8
"""IN_COMMON [1]: smallest share of each response's lines common to all. A few lines drop out where the input is
weak."""
SMOOTHED = 25
"""SMOOTHED [lines]: width of the average of the spread between realisations; few realisations give an uncertain
spread."""


def combine_responses(responses: Sequence[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    """Return all responses as one.

    Responses to the same input are averaged or merged; responses to different inputs form columns. The variance of an
    average includes noise and the additional spread of the realisations.

    Parameters
    ----------
    responses : sequence of MeasuredFrequencyResponse
        Responses with the same outputs.

    Returns
    -------
    MeasuredFrequencyResponse
        Combined response.

    Raises
    ------
    BadRecording
        Different outputs, incompatible lines, or windows of different decay.
    """
    groups: dict[tuple[str, ...], list[MeasuredFrequencyResponse]] = {}
    for response in responses:
        groups.setdefault(response.inputs, []).append(response)
    if len({response.outputs for response in responses}) != 1 or len({r.added_decay for r in responses}) != 1:
        raise BadRecording(
            "the recordings differ in their outputs or windows and have no common response; test them one by one"
        )
    columns = [_one_input(group) for group in groups.values()]
    return columns[0] if len(columns) == 1 else _side_by_side(columns)


def join_outputs(responses: Sequence[MeasuredFrequencyResponse]) -> tuple[MeasuredFrequencyResponse, ...]:
    """Return responses with all outputs each, one input each.

    Responses of different outputs to one input are put together, as from files of one response each.

    Parameters
    ----------
    responses : sequence of MeasuredFrequencyResponse
        Responses in one unit.

    Returns
    -------
    tuple of MeasuredFrequencyResponse
        Responses for `combine_responses`.

    Raises
    ------
    BadRecording
        An output has no response to an input that other outputs respond to. Or outputs have too few lines in common.
    """
    by_input: dict[str, list[MeasuredFrequencyResponse]] = {}
    for response in responses:
        for k, name in enumerate(response.inputs):
            variance = None if response.variance is None else response.variance[:, :, k : k + 1]
            single = replace(response, H=response.H[:, :, k : k + 1], inputs=(name,), variance=variance)
            by_input.setdefault(name, []).append(single)
    outputs = tuple(dict.fromkeys(name for response in responses for name in response.outputs))
    for name, group in by_input.items():
        missing = [output for output in outputs if not any(output in response.outputs for response in group)]
        if missing:
            raise BadRecording(
                f"the response of {missing[0]} to {name} is missing; give it, or name common outputs with --output or other "
                "inputs with --input"
            )
    return tuple(part for group in by_input.values() for part in _whole(group, outputs))


def _whole(group: Sequence[MeasuredFrequencyResponse], outputs: tuple[str, ...]) -> list[MeasuredFrequencyResponse]:
    """Return sets of all outputs from parts of one input.

    An output with several responses is averaged first, unless each part is whole.
    """
    if all(set(part.outputs) == set(outputs) for part in group):
        return [_in_order(part, outputs) for part in group]
    singles = []
    for name in outputs:
        same = [_in_order(part, (name,)) for part in group if name in part.outputs]
        singles.append(_one_input(same))
    lines = _common_lines(singles)
    if lines is None:
        raise BadRecording(
            f"the responses to {singles[0].inputs[0]} have too few frequency lines in common; measure all on one set of lines"
        )
    kept = [single._lines(at) for single, at in zip(singles, lines, strict=True)]
    return [_joined(kept, axis=1, outputs=outputs)]


def _joined(kept: Sequence[MeasuredFrequencyResponse], *, axis: int, **names: Any) -> MeasuredFrequencyResponse:
    """Return responses at common lines, side by side along an axis.

    A multiple coherence is one for all inputs, and the lowest stands for all.
    """
    coherences = [one.coherence for one in kept if one.coherence is not None]
    variances = [one.variance for one in kept if one.variance is not None]
    coherence = None
    if len(coherences) == len(kept):
        coherence = np.concatenate(coherences, axis=1) if axis == 1 else np.min(coherences, axis=0)
    return replace(
        kept[0],
        H=np.concatenate([one.H for one in kept], axis=axis),
        unit=kept[0].unit if len({one.unit for one in kept}) == 1 else "",
        coherence=coherence,
        variance=np.concatenate(variances, axis=axis) if len(variances) == len(kept) else None,
        n_averages=min(one.n_averages for one in kept),
        **names,
    )


def _in_order(response: MeasuredFrequencyResponse, outputs: tuple[str, ...]) -> MeasuredFrequencyResponse:
    rows = [response.outputs.index(name) for name in outputs]
    coherence, variance = (None if part is None else part[:, rows] for part in (response.coherence, response.variance))
    return replace(response, H=response.H[:, rows], outputs=outputs, coherence=coherence, variance=variance)


def _one_input(group: list[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    if len(group) == 1:
        return group[0]
    lines = _common_lines(group)
    if lines is not None:
        return _averaged([response._lines(at) for response, at in zip(group, lines, strict=True)])
    if all(_is_uneven(response.freq) for response in group):
        return merged(group)
    raise BadRecording(
        "the recordings differ in channels or frequency lines and have no common average; test them one by one"
    )


def _is_uneven(freq: Array) -> bool:
    """Return whether lines come from steps instead of a transform."""
    steps = np.diff(freq)
    multiple = freq / max(steps.min(initial=np.inf), 1e-12)
    return bool(np.any(np.abs(multiple - np.round(multiple)) > 1e-3))


def _common_lines(group: Sequence[MeasuredFrequencyResponse]) -> list[NDArray[np.int_]] | None:
    """Return each response's indices of the common lines.

    The result is None with too few common lines.
    """
    step = min(float(np.diff(response.freq).min(initial=np.inf)) for response in group)
    keys = [np.round(response.freq / (1e-3 * step)).astype(np.int64) for response in group]
    common = keys[0]
    for key in keys[1:]:
        common = np.intersect1d(common, key)
    if common.size < IN_COMMON * max(key.size for key in keys) or common.size < 2:
        return None
    return [np.flatnonzero(np.isin(key, common)) for key in keys]


def _averaged(group: Sequence[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    each = np.array([response.H for response in group])
    H, count = each.mean(axis=0), len(group)
    coherences = [r.coherence for r in group if r.coherence is not None]
    variances = [r.variance for r in group if r.variance is not None]
    variance = None
    if len(variances) == count:
        noise = np.mean(variances, axis=0) / count
        spread = np.sum(np.abs(each - H) ** 2, axis=0) / (count * (count - 1))
        beyond = uniform_filter1d(spread - noise, min(SMOOTHED, len(H)), axis=0, mode="nearest")
        variance = noise + np.maximum(beyond, 0.0)
    return replace(
        group[0],
        H=H,
        coherence=np.mean(coherences, axis=0) if len(coherences) == count else None,
        variance=variance,
        n_averages=float(sum(r.n_averages for r in group)),
    )


def _side_by_side(columns: Sequence[MeasuredFrequencyResponse]) -> MeasuredFrequencyResponse:
    names = [name for column in columns for name in column.inputs]
    if len(set(names)) < len(names):
        raise BadRecording(f"an input stands alone and among others ({', '.join(names)}); test them one by one")
    lines = _common_lines(columns)
    if lines is None:
        raise BadRecording(
            "the recordings to different inputs have too few frequency lines in common; excite all in one band with one period"
        )
    kept = [column._lines(at) for column, at in zip(columns, lines, strict=True)]
    return _joined(kept, axis=2, inputs=tuple(names))
