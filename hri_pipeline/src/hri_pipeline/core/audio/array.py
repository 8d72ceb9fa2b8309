"""Geometry of a microphone array: the directions that it can distinguish, and the delays between its microphones."""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.parameters import ParameterError

SPEED_OF_SOUND = 343.0
"""m/s, in dry air at 20 degrees Celsius."""
MIN_EXTENT, MAX_EXTENT = 0.01, 3.0
"""Legal distance (m) between the two outermost microphones."""
AZIMUTH_STEP = math.radians(5.0)
_FLAT = 0.02
"""A dimension smaller than this share of the extent does not count: microphones are not mounted more exactly."""
_LEVEL = math.cos(math.radians(45.0))
_DOME_ELEVATIONS = (-30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0)
_WALL_ELEVATIONS = (-30.0, -15.0, 0.0, 15.0, 30.0)
_FORM = "a list with one text \"x y z\" per channel (m, in the microphone frame)"


def parse_positions(rows: Sequence[Union[str, Sequence[float]]], channels: Optional[int] = None) -> np.ndarray:
    """Return the positions (C, 3), m, of the parameter `microphone_positions`.

    Parameters
    ----------
    rows : sequence
        Per channel "x y z" or three numbers, m.
    channels : int, optional
        How many positions there must be, when it is known.

    Raises
    ------
    ParameterError
        The text says what is wrong and how to correct it.
    """
    if isinstance(rows, str) or len(rows) == 0:
        raise ParameterError("microphone_positions is {!r}; give {}".format(rows, _FORM))
    positions = np.array([_parse_position(index, row) for index, row in enumerate(rows)])
    if channels is not None and len(positions) != channels:
        raise ParameterError("microphone_positions has {} microphones, but the sound has {} channels; give {}".format(
            len(positions), channels, _FORM))
    return check_positions(positions)


def check_positions(positions: np.ndarray) -> np.ndarray:
    """Return positions (C, 3), m, as float64.

    Raises
    ------
    ParameterError
        For less than two microphones, equal positions, or an extent that no array has.
    """
    positions = np.array(positions, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise ParameterError("microphone_positions must be finite numbers, three per microphone; give " + _FORM)
    if len(np.unique(np.round(positions, 4), axis=0)) < len(positions):
        raise ParameterError("microphone_positions has the same place twice; every channel needs a microphone of its "
                             "own")
    if len(positions) < 2:
        raise ParameterError("microphone_positions has one microphone only; a direction needs two, "
                             "and an empty list means that there is no array")
    extent = _extent(positions)
    if not MIN_EXTENT <= extent <= MAX_EXTENT:
        raise ParameterError("microphone_positions: the microphones are at most {:g} m apart; legal: {:g} to {:g} m "
                             "(are the positions in metres?)".format(extent, MIN_EXTENT, MAX_EXTENT))
    return positions


def check_channels(channels: Sequence[int]) -> None:
    """Check the parameter `microphone_channels`: [-1], all, or channels from 0, none twice.

    Raises
    ------
    ParameterError
        The text says what is wrong and how to correct it.
    """
    if list(channels) not in ([], [-1]) and (min(channels) < 0 or len(set(channels)) < len(channels)):
        wrong = "a channel is negative" if min(channels) < 0 else "a channel is there twice"
        raise ParameterError("microphone_channels is {}: {}; give the channel of each microphone, from 0, such as "
                             "[1, 2, 3, 4], or [-1] alone for all".format(list(channels), wrong))


def _parse_position(index: int, row: Union[str, Sequence[float]]) -> Sequence[float]:
    try:
        numbers = [float(word) for word in (row.replace(",", " ").split() if isinstance(row, str) else row)]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise ParameterError("microphone_positions: entry {} is {!r}; give {}".format(index, row, _FORM))
    return numbers


def _extent(positions: np.ndarray) -> float:
    return float(np.linalg.norm(positions[:, None] - positions[None], axis=2).max())


class MicrophoneArray:
    """Microphones at fixed positions, and a grid of the directions that they can distinguish.

    Which directions these are depends on the shape of the array:

    - "line": only the angle to the line is measurable. A direction stands for the cone of all directions with its
      angle; it is given on the front half (x > 0, or y > 0 for a line along x), horizontal where that is possible.
    - "plane": a sound and its mirror image behind the plane are the same. A horizontal array has directions in its
      plane,
      all around: elevation only enters by the cosine of a delay, and echoes from floor and ceiling hide it. An upright
      array is assumed to hear from its front side (x > 0), 30 degrees up and down.
    - "volume": all around, elevation -30 to 60 degrees.

    Parameters
    ----------
    positions : np.ndarray
        (C, 3) m, in the microphone frame.

    Attributes
    ----------
    shape : str
        "line", "plane" or "volume".
    centre : np.ndarray
        (3,) m, mean of the positions.
    extent : float
        m, distance between the two outermost microphones.
    directions : np.ndarray
        (E * A, 3) unit vectors from the array to the sound, E elevations times A azimuths.
    grid_shape : tuple of int
        (E, A).
    wraps : bool
        Whether the azimuths go all around.

    Raises
    ------
    ParameterError
        See check_positions.
    """

    def __init__(self, positions: np.ndarray) -> None:
        self.positions = check_positions(positions)
        self.channels = len(self.positions)
        self.extent = _extent(self.positions)
        self.centre = self.positions.mean(axis=0)
        sizes, axes = self._axes()
        dimensions = int((sizes > _FLAT * sizes[0]).sum())
        self.shape = ("line", "plane", "volume")[dimensions - 1]
        basis, azimuths, elevations, self.wraps = _grid(self.shape, axes)
        self.grid_shape: Tuple[int, int] = (len(elevations), len(azimuths))
        self.azimuth_step = float(azimuths[1] - azimuths[0])
        elevation, azimuth = np.meshgrid(elevations, azimuths, indexing="ij")
        self._basis, self._azimuths, self._elevations = basis, azimuths, elevations
        self.directions = self._unit(azimuth.ravel(), elevation.ravel())

    def _axes(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return the sizes (3,) and axes (3, 3), one per row, of the array, largest first."""
        _, sizes, axes = np.linalg.svd(np.vstack([self.positions - self.centre, np.zeros((3, 3))]), full_matrices=False)
        return sizes, axes

    def _unit(self, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        local = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                          np.sin(elevation)], axis=-1)
        return local @ self._basis

    def direction_between(self, row: float, column: float) -> np.ndarray:
        """Return the unit vector (3,) at fractional indices of elevation (row) and azimuth (column) of the grid."""
        column = column % len(self._azimuths) if self.wraps else column
        azimuth = self._azimuths[0] + column * self.azimuth_step
        elevation = float(np.interp(row, np.arange(len(self._elevations)), self._elevations)
                          if len(self._elevations) > 1 else self._elevations[0])
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)]) @ self._basis

    def delays(self, directions: np.ndarray) -> np.ndarray:
        """Return the delays (..., C), s relative to the centre, of plane waves from `directions` (..., 3)."""
        return -(np.asarray(directions) @ (self.positions - self.centre).T) / SPEED_OF_SOUND

    def steering(self, directions: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """Return the steering vectors (F, D, C), complex64, of `directions` (D, 3) at `frequencies` (F,) in Hz."""
        turns = np.asarray(frequencies)[:, None, None] * self.delays(directions)[None]
        return np.exp(-2j * np.pi * turns).astype(np.complex64)

    def diffuse_coherence(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the coherence (F, C, C) between the microphones of a diffuse field at `frequencies` (F,) in Hz.

        It is the sinc of the distance in half wavelengths (R. K. Cook et al., Journal of the Acoustical Society of
        America 27, 1955).
        """
        apart = np.linalg.norm(self.positions[:, None] - self.positions[None], axis=2)
        return np.sinc(2.0 * np.asarray(frequencies)[:, None, None] * apart[None] / SPEED_OF_SOUND)


def _grid(shape: str, axes: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Return the basis (rows forward, left, up), azimuths and elevations (rad), and whether the azimuths go all
    around."""
    around = np.arange(0.0, 2.0 * np.pi - 1e-9, AZIMUTH_STEP) - np.pi
    half = np.linspace(-0.5 * np.pi, 0.5 * np.pi, int(round(np.pi / AZIMUTH_STEP)) + 1)
    if shape == "line":
        axis = axes[0] * (1.0 if axes[0] @ [1e-3, 1.0, 1e-6] >= 0.0 else -1.0)
        forward = _perpendicular(axis, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        return np.array([forward, axis, np.cross(forward, axis)]), half, np.zeros(1), False
    if shape == "volume":
        return np.eye(3), around, np.radians(_DOME_ELEVATIONS), True
    normal = axes[2]
    if abs(normal[2]) >= _LEVEL:
        up = normal * np.sign(normal[2])
        forward = _perpendicular(up, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        return np.array([forward, np.cross(up, forward), up]), around, np.zeros(1), True
    forward = normal * (1.0 if normal @ [1.0, 1e-3, 0.0] >= 0.0 else -1.0)
    up = _perpendicular(forward, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    return np.array([forward, np.cross(up, forward), up]), half, np.radians(_WALL_ELEVATIONS), False


def _perpendicular(axis: np.ndarray, preferred: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the unit vector at right angles to `axis` that is nearest to `preferred`, or to `other` where that is the
    axis."""
    for vector in (preferred, other):
        rest = vector - (vector @ axis) * axis
        if np.linalg.norm(rest) > 0.1:
            break
    return rest / np.linalg.norm(rest)
