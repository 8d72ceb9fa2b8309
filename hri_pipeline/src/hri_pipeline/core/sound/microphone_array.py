"""Geometry of a microphone array: what its directions are, and how late a sound from each reaches each microphone."""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.parameters import ParameterError

SPEED_OF_SOUND = 343.0
"""m/s, in dry air at 20 degrees Celsius."""
MIN_EXTENT, MAX_EXTENT = 0.01, 3.0
"""Legal distance (m) between the two microphones farthest apart."""
AZIMUTH_STEP = math.radians(5.0)
_FLAT = 0.02
"""A dimension of less than this part of the extent is none: microphones are not mounted more exactly."""
_LEVEL = math.cos(math.radians(45.0))
_DOME_ELEVATIONS = (-30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0)
_WALL_ELEVATIONS = (-30.0, -15.0, 0.0, 15.0, 30.0)
_FORM = "a list with one text \"x y z\" per channel (m, in the microphone frame)"


def parse_positions(rows: Sequence[Union[str, Sequence[float]]], channels: Optional[int] = None) -> np.ndarray:
    """Return the positions (C, 3) m of the microphones out of the parameter `microphone_positions`.

    rows: per channel "x y z" or three numbers, m. channels: how many there must be, when known.
    Raises ParameterError that tells what is wrong and how to mend it.
    """
    if isinstance(rows, str) or len(rows) == 0:
        raise ParameterError("microphone_positions is {!r}; give {}".format(rows, _FORM))
    positions = np.array([_parse_position(index, row) for index, row in enumerate(rows)])
    if channels is not None and len(positions) != channels:
        raise ParameterError("microphone_positions has {} microphones, but the sound has {} channels; give {}".format(
            len(positions), channels, _FORM))
    return check_positions(positions)


def check_positions(positions: np.ndarray) -> np.ndarray:
    """Return positions (C, 3) m as float64; ParameterError for less than two places, or an extent that no array has."""
    positions = np.array(positions, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise ParameterError("microphone_positions must be finite numbers, three per microphone; give " + _FORM)
    if len(np.unique(np.round(positions, 4), axis=0)) < len(positions):
        raise ParameterError("microphone_positions has the same place twice; every channel needs a microphone of its own")
    if len(positions) < 2:
        raise ParameterError("microphone_positions has one microphone only; a direction needs two, "
                             "and an empty list means that there is no array")
    extent = _extent(positions)
    if not MIN_EXTENT <= extent <= MAX_EXTENT:
        raise ParameterError("microphone_positions: the microphones are at most {:g} m apart; legal: {:g} to {:g} m "
                             "(are the positions in metres?)".format(extent, MIN_EXTENT, MAX_EXTENT))
    return positions


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
    """Microphones at fixed places, and a grid of the directions that they can tell apart.

    shape "line": only the angle against the line can be told: a direction stands for the cone of all with its angle,
    and is given on the front half (x > 0, or y > 0 for a line along x), level where that is possible.
    shape "plane": what comes from one side of the plane looks like its mirror image. Of a level array directions
    are given in its plane, all around: its elevation is the cosine of a delay, and echoes from floor and ceiling leave
    nothing of that. An upright array is taken to hear from its front side (x > 0), 30 degrees up and down.
    shape "volume": all around, elevation -30 to 60 degrees.

    The grid is `directions` (E * A, 3), unit vectors from the array to the sound: E elevations times A azimuths.
    """

    def __init__(self, positions: np.ndarray) -> None:
        """positions: (C, 3) m in the microphone frame. Raises ParameterError, see `check_positions`."""
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
        """Sizes (3,) and axes (3, 3, one per row) of the array, largest first."""
        _, sizes, axes = np.linalg.svd(np.vstack([self.positions - self.centre, np.zeros((3, 3))]), full_matrices=False)
        return sizes, axes

    def _unit(self, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        local = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                          np.sin(elevation)], axis=-1)
        return local @ self._basis

    def direction_between(self, row: float, column: float) -> np.ndarray:
        """Return the unit vector (3,) at a place between the points of the grid (fractional elevation, azimuth index)."""
        column = column % len(self._azimuths) if self.wraps else column
        azimuth = self._azimuths[0] + column * self.azimuth_step
        elevation = float(np.interp(row, np.arange(len(self._elevations)), self._elevations)
                          if len(self._elevations) > 1 else self._elevations[0])
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)]) @ self._basis

    def delays(self, directions: np.ndarray) -> np.ndarray:
        """Return when a plane wave from each direction (..., 3) reaches each microphone (..., C), s after the centre."""
        return -(np.asarray(directions) @ (self.positions - self.centre).T) / SPEED_OF_SOUND

    def steering(self, directions: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """Return the phase factors (F, D, C), complex64, of plane waves from `directions` (D, 3) at `frequencies` Hz."""
        turns = np.asarray(frequencies)[:, None, None] * self.delays(directions)[None]
        return np.exp(-2j * np.pi * turns).astype(np.complex64)

    def diffuse_coherence(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the coherence (F, C, C) between microphones of sound from everywhere at once: sinc of the distance in
        half wavelengths (R. K. Cook et al., Journal of the Acoustical Society of America 27, 1955)."""
        apart = np.linalg.norm(self.positions[:, None] - self.positions[None], axis=2)
        return np.sinc(2.0 * np.asarray(frequencies)[:, None, None] * apart[None] / SPEED_OF_SOUND)


def _grid(shape: str, axes: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Basis (rows forward, left, up), azimuths and elevations (rad) of the grid, and whether azimuth wraps around."""
    around = np.arange(0.0, 2.0 * np.pi - 1e-9, AZIMUTH_STEP) - np.pi
    half = np.linspace(-0.5 * np.pi, 0.5 * np.pi, int(round(np.pi / AZIMUTH_STEP)) + 1)
    if shape == "line":
        axis = axes[0] * (1.0 if axes[0] @ [1e-3, 1.0, 1e-6] >= 0.0 else -1.0)
        forward = _across(axis, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        return np.array([forward, axis, np.cross(forward, axis)]), half, np.zeros(1), False
    if shape == "volume":
        return np.eye(3), around, np.radians(_DOME_ELEVATIONS), True
    normal = axes[2]
    if abs(normal[2]) >= _LEVEL:
        up = normal * np.sign(normal[2])
        forward = _across(up, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        return np.array([forward, np.cross(up, forward), up]), around, np.zeros(1), True
    forward = normal * (1.0 if normal @ [1.0, 1e-3, 0.0] >= 0.0 else -1.0)
    up = _across(forward, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    return np.array([forward, np.cross(up, forward), up]), half, np.radians(_WALL_ELEVATIONS), False


def _across(axis: np.ndarray, wish: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The unit vector at right angles to `axis` that is closest to `wish`, or to `other` where that is the axis."""
    for vector in (wish, other):
        rest = vector - (vector @ axis) * axis
        if np.linalg.norm(rest) > 0.1:
            break
    return rest / np.linalg.norm(rest)
