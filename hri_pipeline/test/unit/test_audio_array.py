"""Positions of microphones as people write them, grids of directions, and delays of plane waves."""

import numpy as np
import pytest

from hri_pipeline.core.audio.array import SPEED_OF_SOUND, MicrophoneArray, check_channels, parse_positions
from hri_pipeline.core.parameters import ParameterError

SQUARE = [[0.04, 0.04, 0.0], [-0.04, 0.04, 0.0], [-0.04, -0.04, 0.0], [0.04, -0.04, 0.0]]
PAIR = [[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]]
UPRIGHT = [[0.0, 0.1, 0.1], [0.0, -0.1, 0.1], [0.0, -0.1, -0.1], [0.0, 0.1, -0.1]]
PYRAMID = SQUARE + [[0.0, 0.0, 0.05]]


@pytest.mark.parametrize("rows, word", [
    ([], "give a list"), ("0 0 0", "give a list"), (["0 0 0"], "one microphone"), (["0 0", "1 0 0"], "entry 0"),
    (["0 0 0", "a b c"], "entry 1"), (["0 0 0", "nan 0 0"], "entry 1"), (["0 0 0", "inf 0 0"], "entry 1"),
    (["0 0 0", None], "entry 1"), (["0 0 0", "0 0 0"], "same place"), (["0 0 0", "0.1 0 0", "0.1 0 0"], "same place"),
    (["0 0 0", "0.004 0 0"], "metres"), (["0 0 0", "40 0 0"], "metres"), (["0 0 0", "0.1 0 0"], "4 channels")])
def test_wrong_positions_are_named_with_a_hint(rows, word):
    with pytest.raises(ParameterError) as raised:
        parse_positions(rows, 4 if "channels" in word else None)
    assert "microphone_positions" in str(raised.value) and word in str(raised.value)


def test_positions_are_read_from_texts_and_from_numbers():
    texts = ["0.04 0.04 0", "-0.04, 0.04, 0.0", "-4e-2 -0.04 0", "0.04 -0.04 0"]
    np.testing.assert_allclose(parse_positions(texts, 4), SQUARE)
    np.testing.assert_allclose(parse_positions(SQUARE), SQUARE)


@pytest.mark.parametrize("positions, shape",
                         [(PAIR, "line"), (SQUARE, "plane"), (UPRIGHT, "plane"), (PYRAMID, "volume")])
def test_the_grid_suits_what_the_array_can_tell(positions, shape):
    array = MicrophoneArray(positions)
    assert array.shape == shape
    np.testing.assert_allclose(np.linalg.norm(array.directions, axis=1), 1.0)
    assert array.directions.shape[0] == array.grid_shape[0] * array.grid_shape[1]
    if shape == "line" or positions is UPRIGHT:
        assert array.directions[:, 0].min() > -1e-9
    if positions is SQUARE:
        np.testing.assert_allclose(array.directions[:, 2], 0.0, atol=1e-12)
        assert array.wraps
    # No two directions of the grid look alike to the microphones.
    delays = array.delays(array.directions)
    apart = np.abs(delays[:, None] - delays[None]).max(axis=2) + np.eye(len(delays))
    assert apart.min() > 1e-8


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 2, 0.5)])
def test_a_line_of_any_orientation_has_directions_with_all_its_angles(axis):
    axis = np.array(axis, dtype=float) / np.linalg.norm(axis)
    array = MicrophoneArray([0.05 * axis, -0.05 * axis, 0.01 * axis])
    angles = np.degrees(np.arccos(np.clip(array.directions @ axis, -1.0, 1.0)))
    np.testing.assert_allclose(np.sort(angles), np.linspace(0.0, 180.0, len(angles)), atol=1e-6)


def test_the_nearer_microphone_hears_it_first():
    array = MicrophoneArray(PAIR)
    delays = array.delays(np.array([0.0, 1.0, 0.0]))
    assert delays[0] < delays[1]
    assert delays[1] - delays[0] == pytest.approx(0.1 / SPEED_OF_SOUND)


def test_between_two_points_of_the_grid_lies_the_direction_between():
    array = MicrophoneArray(SQUARE)
    ends = array.directions[[3, 4]]
    between = array.direction_between(0.0, 3.5)
    np.testing.assert_allclose(between, ends.sum(axis=0) / np.linalg.norm(ends.sum(axis=0)), atol=1e-9)
    np.testing.assert_allclose(array.direction_between(0.0, -1.0), array.directions[-1], atol=1e-9)


def test_diffuse_sound_is_alike_at_one_place_and_not_far_away():
    coherence = MicrophoneArray([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]).diffuse_coherence(np.array([0.0, 3000.0]))
    np.testing.assert_allclose(coherence[0], 1.0)
    np.testing.assert_allclose(np.diag(coherence[1]), 1.0)
    assert abs(coherence[1, 0, 1]) < 0.05


@pytest.mark.parametrize("channels", [[-1], [], [0], [1, 2, 3, 4], [3, 1]])
def test_channels_are_all_or_each_once(channels):
    check_channels(channels)


@pytest.mark.parametrize("channels, wrong", [
    ([-1, 2], "negative"), ([2, -1], "negative"), ([-1, -1], "negative"), ([1, 1], "twice")])
def test_channels_that_contradict_themselves_are_refused(channels, wrong):
    with pytest.raises(ParameterError, match=r"microphone_channels is \[.*{}.*\[-1\] alone for all".format(wrong)):
        check_channels(channels)
