"""MAC, COMAC, pairing and orthogonality against closed forms."""

import numpy as np
import pytest

from vlab.errors import BadRecording
from vlab.modal.mac import comac, mac, match_modes, orthogonality
from vlab.signals import ModalModel


def sines(n=8):
    k = np.arange(1, n + 1)
    return np.sin(np.pi * np.outer(k, k) / (n + 1))


def test_mac_of_orthogonal_shapes_is_the_identity_whatever_scale_and_phase():
    shapes = sines()
    turned = shapes * np.exp(1j * np.arange(8)) * np.geomspace(1e-6, 1e6, 8)
    np.testing.assert_allclose(mac(shapes, turned), np.eye(8), atol=1e-14)  # rounding of sums of eight


def test_mac_is_the_squared_cosine():
    angle = np.linspace(0, np.pi / 2, 7)
    shapes = np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(mac([[1.0], [0.0]], shapes)[0], np.cos(angle) ** 2, atol=1e-15)


def test_comac_is_the_squared_cosine_between_the_magnitudes_at_a_coordinate():
    shapes = sines()
    np.testing.assert_allclose(comac(shapes, -shapes), 1.0)
    a = np.array([[3.0, 4.0], [4.0, -3.0], [0.0, 0.0]])
    b = np.array([[4.0, 3.0], [3.0, -4.0], [0.0, 0.0]])
    np.testing.assert_allclose(comac(a, 7 * b), [(24 / 25) ** 2, (24 / 25) ** 2, 1.0], rtol=1e-14)


def model(order, coordinates, shift=1.0):
    rows = [int(name[1:]) for name in coordinates]
    freq = 10 * np.sin(np.arange(1, 9) * np.pi / 18) * shift
    return ModalModel(
        freq=freq[order], zeta=np.full(len(order), 0.01), shapes=sines()[rows][:, order], coordinates=coordinates
    )


def test_modes_are_matched_across_order_coordinates_and_frequency_shift():
    names = [f"x{i}" for i in range(8)]
    order = np.array([4, 0, 6, 2])
    pairs = match_modes(model(np.arange(8), names), model(order, [*names[::-1]], shift=1.1))
    assert pairs.coordinates == tuple(names)
    np.testing.assert_array_equal(pairs.a, np.sort(order))
    np.testing.assert_array_equal(order[pairs.b], pairs.a)
    np.testing.assert_allclose(pairs.mac, 1.0, atol=1e-12)
    np.testing.assert_allclose(pairs.freq_error, 0.1, rtol=1e-12)


def test_frequency_decides_between_shapes_that_the_sensors_cannot_tell_apart():
    names = ["x0", "x1"]
    shapes = np.array([[1.0, 1.0], [0.5, 0.5]])
    a = ModalModel(freq=[2.0, 9.0], zeta=[0.01, 0.01], shapes=shapes, coordinates=names)
    b = ModalModel(freq=[8.9, 2.1], zeta=[0.01, 0.01], shapes=shapes, coordinates=names)
    np.testing.assert_array_equal(match_modes(a, b).b, [1, 0])


def test_pairs_below_the_least_mac_are_left_out():
    names = [f"x{i}" for i in range(8)]
    pairs = match_modes(model(np.array([0, 1]), names), model(np.array([1, 5]), names), min_mac=0.5)
    np.testing.assert_array_equal(pairs.a, [1])
    np.testing.assert_array_equal(pairs.b, [0])


def test_orthogonality_of_true_modes_is_the_identity_and_of_perturbed_ones_known():
    M = np.diag([1.0, 2.0, 3.0])
    shapes = np.linalg.inv(np.sqrt(M)) @ np.linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0] * [1.0, 5.0, 0.1]
    np.testing.assert_allclose(orthogonality(shapes, M), np.eye(3), atol=1e-14)
    mixed = shapes.copy()
    mixed[:, 0] = shapes[:, 0] + 0.1 * shapes[:, 1] / 5.0  # a tenth of the second, both of unit modal mass
    assert orthogonality(mixed, M)[0, 1] == pytest.approx(0.1 / np.sqrt(1.01), rel=1e-12)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: mac(np.ones((3, 1)), np.ones((4, 1))), "3 and 4 coordinates"),
        (lambda: mac(np.zeros((3, 1)), np.ones((3, 1))), "zero everywhere"),
        (lambda: mac(np.ones(3), np.ones((3, 1))), "coordinate, mode"),
        (lambda: comac(np.ones((3, 1)), np.ones((3, 2))), "paired shapes"),
        (lambda: orthogonality(np.ones((3, 1)), np.eye(2)), "do not fit"),
        (lambda: orthogonality(np.ones((2, 1)), -np.eye(2)), "positive definite"),
        (lambda: match_modes(model([0], ["x0", "x1"]), model([0], ["x1", "x2"])), "1 coordinates in common"),
    ],
)
def test_refuses_shapes_that_cannot_be_compared(call, match):
    with pytest.raises(BadRecording, match=match):
        call()
