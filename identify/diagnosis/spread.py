"""How large the noise really is, and whether it grows with the distance to the instrument.

The covariance of a visit is a sum of three parts of known shape: instrument, reading jitter and pose jitter
(`identify.noise`). Their sizes follow from the whitened residuals by Fisher scoring (maximum likelihood of variance
components; Searle, Casella and McCulloch, Variance Components, 1992, ch. 8). They are reported; no cause is accepted
or refused on their strength.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, Ints
from identify.fit import Fit
from identify.noise import instrument_covariance
from identify.study import Noise, Tracker
from identify.tails import gamma_sf, student_sf

__all__ = [
    "NoiseFound",
    "RangeNoise",
    "louder_than_stated",
    "noise_found",
    "noise_parts",
    "range_noise",
    "scaled",
    "sizes_of",
    "wider",
]

_STEPS = 10
_LEAST = 1e-4  # a share of variance below this is as good as zero
_LEAST_VISITS = 10
_SPREAD = 1.15  # ratio of the largest to the smallest distance that makes a dependence visible


@dataclass(frozen=True)
class NoiseFound:
    """Sizes of the parts of the noise, as multiples of the stated ones (1 sigma).

    Attributes:
        reading: Of the instrument.
        reading_jitter: Of the joints between readings; 1 where none is stated.
        pose_jitter: Of the joints between visits; 1 where none is stated, or where changes hide it.
    """

    reading: float
    reading_jitter: float
    pose_jitter: float


@dataclass(frozen=True, eq=False)
class RangeNoise:
    """Noise that depends on the distance to the instrument.

    Attributes:
        p_value: Probability of such a dependence if there is none.
        noise: The stated noise with the instrument's part as found, growing with the distance.
    """

    p_value: float
    noise: Noise


def noise_found(found: Fit, noise: Noise) -> NoiseFound:
    """Estimate the sizes of the noise parts from the residuals of a fit.

    Args:
        found: A fit with weights of one.
        noise: The noise it was made with.
    """
    active = np.array([True, noise.reading_jitter > 0, noise.pose_jitter > 0 and not found.whitening.cancels])
    return sizes_of(noise_parts(found, noise), active, found.dof / max(len(found.whitened), 1))


def louder_than_stated(found: Fit, noise: Noise) -> float:
    """Probability of scatter so large along any part of the noise if all are as stated.

    The score of each part, ``sum_i r_i' W_i r_i``, is held against a gamma distribution with the two moments that it
    has under the stated noise; chi-square of all rows together would drown a doubled jitter. The smallest of the
    three probabilities counts three times (Bonferroni).

    Args:
        found: A fit with weights of one.
        noise: The noise it was made with.
    """
    columns = found.columns[:, found.identifiability.kept]
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    total, mean, spread, start = np.zeros(3), np.zeros(3), np.zeros(3), 0
    for error, covariances in noise_parts(found, noise):
        count, size = error.shape
        own = basis[start : start + count * size].reshape(count, size, -1)
        start += count * size
        seen = covariances @ (np.eye(size) - own @ own.swapaxes(1, 2))[:, None]
        total += np.einsum("gk,gakl,gl->a", error, covariances, error, optimize=True)
        mean += np.einsum("gakk->a", seen)
        spread += 2.0 * np.einsum("gakl,galk->a", seen, seen, optimize=True)
    told = mean > 0
    single = [
        gamma_sf(*part)
        for part in zip(total[told], mean[told] ** 2 / spread[told], spread[told] / mean[told], strict=True)
    ]
    return min(1.0, 3.0 * min(single, default=1.0))


def sizes_of(parts: list[tuple[Floats, Floats]], active: np.ndarray, lost: float) -> NoiseFound:
    """Sizes of the parts of the noise from errors and their covariances.

    Args:
        parts: Errors (G, k) and the covariances of the three parts of the noise (G, 3, k, k), by groups of visits.
        active: (3,) True for parts that the errors show; the others count as stated.
        lost: Share of the equations that no parameter took.
    """
    share = np.ones(3)
    for _ in range(_STEPS):
        share[active] = np.maximum(_scored(parts, share, active, lost), _LEAST)
    return NoiseFound(*np.sqrt(share).tolist())


def wider(sizes: NoiseFound) -> NoiseFound:
    """The same sizes, none smaller than stated."""
    return NoiseFound(*(max(size, 1.0) for size in (sizes.reading, sizes.reading_jitter, sizes.pose_jitter)))


def scaled(noise: Noise, sizes: NoiseFound) -> Noise:
    """The stated noise with its parts multiplied by sizes."""
    reading, shots, poses = sizes.reading, sizes.reading_jitter, sizes.pose_jitter
    tracker = noise.tracker
    if tracker is not None:
        parts = ("radial", "radial_per_m", "transverse", "transverse_per_m")
        tracker = replace(tracker, **{part: reading * getattr(tracker, part) for part in parts})
    return replace(
        noise,
        reading=reading * noise.reading,
        tracker=tracker,
        reading_jitter=shots * noise.reading_jitter,
        pose_jitter=poses * noise.pose_jitter,
    )


def noise_parts(found: Fit, noise: Noise) -> list[tuple[Floats, Floats]]:
    """For each group of visits the whitened residual (G, k) and the three whitened covariances (G, 3, k, k)."""
    scene, experiment = found.response.scene, found.data.experiment
    own = instrument_covariance(noise, scene.point, found.state.base_T_measurement[:3, 3])
    made, start = [], 0
    for index, operator in found.whitening.groups:
        size = operator.shape[1]
        error = found.whitened[start : start + len(index) * size].reshape(len(index), size)
        start += len(index) * size
        split = operator.reshape(len(index), size, index.shape[1], 3)
        instrument = np.einsum("gkmi,gmij,glmj->gkl", split, own[index], split, optimize=True)
        turned = np.einsum("gkmi,gmsi->gkms", split, scene.joints.motion[index], optimize=True)
        pose = turned.sum(axis=2)
        shots = _by_shot(turned, experiment.row_shot[index])
        jitter = noise.reading_jitter**2 * np.einsum("gkts,glts->gkl", shots, shots, optimize=True)
        made.append((error, np.stack([instrument, jitter, noise.pose_jitter**2 * pose @ pose.swapaxes(1, 2)], axis=1)))
    return made


def _by_shot(rows: Floats, shot: Ints) -> Floats:
    """(G, k, m, s) summed over the rows of each shot, (G, k, t, s); the m rows of a visit stand shot by shot."""
    local = np.cumsum(np.diff(shot, axis=1, prepend=shot[:, :1]) != 0, axis=1)
    which = local[:, :, None] == np.arange(local.max() + 1)
    summed: Floats = np.einsum("gkms,gmt->gkts", rows, which.astype(np.float64), optimize=True)
    return summed


def _scored(parts: list[tuple[Floats, Floats]], share: Floats, active: np.ndarray, lost: float) -> Floats:
    """One step of Fisher scoring for the active shares of variance; the others stay."""
    fisher, right = np.zeros((3, 3)), np.zeros(3)
    for error, covariances in parts:
        total = np.tensordot(share, covariances, axes=(0, 1))
        total += 1e-9 * np.eye(total.shape[1])
        weighed = np.linalg.solve(total[:, None], covariances)
        fisher += np.einsum("gakl,gblk->ab", weighed, weighed, optimize=True)
        solved = np.linalg.solve(total, error[..., None])[..., 0]
        right += np.einsum("gk,gakl,gl->a", solved, covariances, solved, optimize=True)
    known = fisher[active][:, ~active] @ share[~active]
    return np.asarray(np.linalg.lstsq(fisher[active][:, active], right[active] / lost - known, rcond=1e-10)[0])


def range_noise(found: Fit, noise: Noise) -> RangeNoise | None:
    """Does the scatter of single readings grow with the distance to the instrument?

    The squared distance of each reading from what the others of its visit say (`Fit.z`), averaged over a visit, is
    regressed on the squared distance to the instrument (Breusch and Pagan 1979, in Koenker's form). None where
    the distances hardly differ, the noise is stated by distance already, or there are too few visits.
    """
    if noise.tracker is not None or noise.reading == 0.0 or not found.model.frame_size:
        return None
    compared = found.z > 0
    visit = found.data.experiment.row_visit[compared]
    count = np.bincount(visit)
    names = np.flatnonzero(count)
    distance = np.linalg.norm(found.response.scene.point - found.state.base_T_measurement[:3, 3], axis=1)[compared]
    mean = (np.bincount(visit, distance)[names]) / count[names]
    scatter = (np.bincount(visit, found.z[compared] ** 2 / 3.0)[names]) / count[names]
    if len(names) < _LEAST_VISITS or mean.max() < _SPREAD * mean.min():
        return None
    slope, intercept, p_value = _rising(mean**2, scatter)
    ends = np.maximum(intercept + slope * np.array([mean.min(), mean.max()]) ** 2, _LEAST)
    low, high = noise.reading * np.sqrt(ends)
    growth = float((high - low) / (mean.max() - mean.min()))
    constant = float(max(low - growth * mean.min(), 0.0))
    tracker = Tracker(radial=constant, radial_per_m=growth, transverse=constant, transverse_per_m=growth)
    return RangeNoise(p_value, replace(noise, tracker=tracker, reading=0.0))


def _rising(x: Floats, y: Floats) -> tuple[float, float, float]:
    """Slope and intercept of a line through points (n,), and the probability of such a slope if there is none."""
    slope, intercept = np.polyfit(x, y, 1)
    rest = y - intercept - slope * x
    spread = np.sqrt((rest @ rest) / (len(x) - 2) / ((x - x.mean()) ** 2).sum())
    return float(slope), float(intercept), float(student_sf(slope / max(spread, 1e-300), len(x) - 2))
