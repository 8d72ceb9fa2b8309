"""One beamformer per direction: what each source alone sounds like at the first microphone.

Every source is a zero-mean Gaussian with a power per bin that changes from frame to frame, and a spatial covariance of full
rank per bin that hardly changes (N. Duong, E. Vincent and R. Gribonval, "Under-determined reverberant audio source
separation using a full-rank spatial covariance model", IEEE Transactions on Audio, Speech and Language Processing 18,
2010). The multichannel Wiener filter of that model is the MVDR beamformer against all other sources and the noise,
followed by its single-channel postfilter. Powers follow by the multiplicative update of H. Sawada et al. ("Multichannel
extensions of non-negative matrix factorization with complex-valued data", same journal 21, 2013), one step per frame;
covariances begin as a plane wave from the direction plus sound from everywhere, and learn what the room makes of it.
"""

from __future__ import annotations

from typing import Dict, List

import numpy as np

from hri_pipeline.core.sound.microphone_array import MicrophoneArray
from hri_pipeline.core.sound.sound_spectra import BINS, FREQUENCIES, mean_power

POWER_MEMORY = 0.95
"""Memory of a source's power from one frame to the next (0.3 s): less makes voices shrill, more lets echoes of others in."""
POWER_STEP = 1.5
"""Exponent of the update of the powers. 1 is a whole step towards the maximum likelihood; more makes up for there being one
step only; from 2.5 on powers swing."""
DIFFUSE_PART = 0.6
"""Part of a new source's covariance that comes from everywhere: echoes, and errors of the direction."""
LEARNING_RATE, LEARN_EVERY = 0.12, 4
"""Part of a covariance that a frame renews where the source has the bin to itself; covariances learn of every fourth
frame (0.5 s)."""
NOISE_FACTOR = 1.1
LOADING = 1e-3
"""Least noise (diagonal loading), of the power of all sources: no filter takes out more than 30 dB."""
LEAST = 1e-3
"""A source has at least this part of the power of the noise in each bin, so that it can come back."""
ANCHOR = 0.3
"""Part that the expected covariance of the direction has in what is learnt: what was learnt wrong is forgotten."""
TURN = np.cos(np.radians(8.0))
"""A source that moved by more than this is expected elsewhere, and what was learnt of it is forgotten. That of all sources is
when a new one comes: until now it was taken for a part of the others."""


class SourceBeamformers:
    """Filters for a changing set of sources of one array.

    Arrays have the frequency last, (..., BINS), so that numpy runs along it.
    """

    def __init__(self, array: MicrophoneArray) -> None:
        self._array = array
        self._diffuse = _frequency_last(array.diffuse_coherence(FREQUENCIES))
        self.reset()

    def reset(self) -> None:
        """Drop all sources."""
        self._keys: List[int] = []
        self._aims = np.zeros((0, 3))
        channels = self._array.channels
        self._covariances = np.zeros((0, channels, channels, BINS), dtype=np.complex64)
        self._expected = self._covariances.copy()
        self._powers = np.zeros((0, BINS), dtype=np.float32)
        self._frame = 0

    def aim(self, directions: Dict[int, np.ndarray]) -> None:
        """Keep filters for exactly the sources `directions`, key -> (3,) unit vector: new ones begin, others end."""
        stay = [row for row, key in enumerate(self._keys) if key in directions]
        if len(stay) < len(self._keys):
            self._keys = [self._keys[row] for row in stay]
            self._aims, self._expected = self._aims[stay], self._expected[stay]
            self._covariances, self._powers = self._covariances[stay], self._powers[stay]
        new = [key for key in directions if key not in self._keys]
        for row, key in enumerate(self._keys):
            turned = self._aims[row] @ directions[key] < TURN
            if turned:
                self._aims[row] = directions[key]
                self._expected[row] = self._expect(directions[key])
            if turned or new:
                self._covariances[row] = self._expected[row]
        for key in new:
            self._keys.append(key)
            expected = self._expect(directions[key])[None]
            self._aims = np.vstack([self._aims, directions[key]])
            self._expected = np.concatenate([self._expected, expected])
            self._covariances = np.concatenate([self._covariances, expected])
            self._powers = np.vstack([self._powers, np.zeros((1, BINS), dtype=np.float32)])

    def separate(self, spectrum: np.ndarray, noise: np.ndarray) -> Dict[int, np.ndarray]:
        """Return key -> spectrum (BINS,) of each source at the first microphone.

        spectrum: (C, BINS) of one frame; noise: (BINS,) power of the noise in each channel.
        """
        if not self._keys:
            return {}
        noise = np.float32(NOISE_FACTOR) * noise
        share = np.maximum(mean_power(spectrum) - noise, LEAST * noise) / len(self._keys)
        powers = POWER_MEMORY * self._powers + (1.0 - POWER_MEMORY) * share
        inverted = inverse(self._total(powers, noise))
        whitened = _times(inverted, spectrum)
        seen = np.einsum("if,sif->sf", whitened.conj(), _times(self._covariances, whitened)).real
        # The trace of a product of Hermitian matrices.
        expected = np.einsum("ijf,sijf->sf", inverted.conj(), self._covariances).real
        step = (np.maximum(seen, 0.0) / np.maximum(expected, 1e-30)) ** POWER_STEP
        self._powers = np.maximum(powers * step, LEAST * noise).astype(np.float32)
        return self._filter(spectrum, noise)

    def _filter(self, spectrum: np.ndarray, noise: np.ndarray) -> Dict[int, np.ndarray]:
        total = self._total(self._powers, noise)
        self._frame += 1
        learns = self._frame % LEARN_EVERY == 0
        inverted = inverse(total) if learns else None
        whitened = solve(total, spectrum) if inverted is None else _times(inverted, spectrum)
        images = self._powers[:, None] * _times(self._covariances, whitened)
        if inverted is not None:
            self._learn(inverted, images, noise)
        return {key: images[row, 0] for row, key in enumerate(self._keys)}

    def _learn(self, inverted: np.ndarray, images: np.ndarray, noise: np.ndarray) -> None:
        """Move each covariance towards what this frame says of it, as far as the source has the bin to itself."""
        share = self._powers / (self._powers.sum(axis=0) + noise)
        for row in range(len(self._keys)):
            covariance, power = self._covariances[row], self._powers[row]
            # Covariance of the source given the frame: that of its estimate plus what the estimate leaves open.
            found = _product(covariance, _product(inverted, covariance))
            found *= -power
            found += covariance
            found *= power
            found += images[row][:, None] * images[row].conj()[None]
            level = np.einsum("iif->f", found).real / self._array.channels
            rate = LEARNING_RATE * share[row]
            found *= (1.0 - ANCHOR) * rate / np.maximum(level, 1e-30)
            covariance *= 1.0 - rate
            covariance += found
            covariance += ANCHOR * rate * self._expected[row]

    def _total(self, powers: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Covariance (C, C, BINS) of all that is heard."""
        total = powers[0] * self._covariances[0]
        for power, covariance in zip(powers[1:], self._covariances[1:]):
            total += power * covariance
        least = np.maximum(noise, LOADING * powers.sum(axis=0))
        for channel in range(self._array.channels):
            total[channel, channel] += least
        return total

    def _expect(self, direction: np.ndarray) -> np.ndarray:
        """Covariance (C, C, BINS), mean of the diagonal 1, of sound from a direction in a room."""
        wave = self._array.steering(direction[None], FREQUENCIES)[:, 0].T
        direct = wave[:, None] * wave.conj()[None]
        return ((1.0 - DIFFUSE_PART) * direct + DIFFUSE_PART * self._diffuse).astype(np.complex64)


def inverse(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of Hermitian positive definite matrices (C, C, F), for all F at once.

    Gauss-Jordan without pivoting, which such matrices do not need; LAPACK takes five times as long for small ones.
    """
    left = matrices.copy()
    change = np.empty_like(left)
    for pivot in range(len(left)):
        scale = 1.0 / left[pivot, pivot].real
        row = left[pivot] * scale
        column = left[:, pivot].copy()
        left -= np.multiply(column[:, None], row, out=change)
        left[:, pivot] = column * -scale
        left[pivot] = row
        left[pivot, pivot] = scale
    return left


def solve(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the inverses of Hermitian positive definite matrices (C, C, F) times the vectors (C, F), for all F at once.

    Gauss elimination without pivoting: less than half the work of the inverse.
    """
    left, right = matrices.copy(), vectors.copy()
    scales = []
    for pivot in range(len(left)):
        scales.append(1.0 / left[pivot, pivot].real)
        factors = left[pivot + 1:, pivot] * scales[pivot]
        left[pivot + 1:, pivot + 1:] -= factors[:, None] * left[pivot, pivot + 1:]
        right[pivot + 1:] -= factors * right[pivot]
    for pivot in range(len(left) - 1, -1, -1):
        right[pivot] -= np.sum(left[pivot, pivot + 1:] * right[pivot + 1:], axis=0)
        right[pivot] *= scales[pivot]
    return right


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Matrices (..., C, C, F) times vectors (C, F): (..., C, F)."""
    return np.einsum("...ijf,jf->...if", matrices, vectors)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Matrices (C, C, F) times matrices (C, C, F)."""
    return np.einsum("ijf,jkf->ikf", a, b)


def _frequency_last(matrices: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(matrices, 0, -1))
