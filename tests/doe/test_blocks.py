"""Blocks as they come: any float type, memory-mapped, read-only, ill-scaled; rank and row space."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from plain_design import value_of
from reference_cases import reference_case

from doe import approximate_design, exact_design
from doe.blocks import Blocks
from doe.row_space import row_space
from identify.errors import InputError, NotIdentifiable


def some(count=60, k=3, p=5, seed=0):
    return np.random.default_rng(seed).normal(size=(count, k, p))


def rank(blocks, prior=None):
    stream = Blocks(blocks)
    return row_space(stream, np.zeros((stream.p, stream.p)) if prior is None else prior).basis.shape[1]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, ">f8", np.int64])
def test_every_number_type_gives_the_result_of_its_float64_copy(dtype):
    blocks = (some() * 3).astype(dtype)
    target = np.ones((1, 5)) + np.eye(5)[:2]
    design = approximate_design(blocks, target)
    assert design.value == pytest.approx(approximate_design(blocks.astype(float), target).value, rel=3e-6)


def test_memory_mapped_read_only_and_strided_blocks_are_left_alone(tmp_path):
    blocks, target = reference_case(400, 6)
    np.save(tmp_path / "blocks.npy", blocks)
    mapped = np.load(tmp_path / "blocks.npy", mmap_mode="r")
    frozen = blocks.copy()
    frozen.setflags(write=False)
    wide = np.zeros((400, 18, 6))
    wide[:, ::2] = blocks
    plain = approximate_design(blocks, target)
    for other in (mapped, frozen, np.asfortranarray(blocks), wide[:, ::2]):
        assert approximate_design(other, target).value == pytest.approx(plain.value, rel=1e-9)
        assert exact_design(other, target, 5, effort="low").counts.sum() == 5
    np.testing.assert_array_equal(mapped, blocks)
    np.testing.assert_array_equal(frozen, blocks)


def test_the_blocks_are_never_copied_whole():
    blocks, target = reference_case(20_000, 6)
    big = np.repeat(blocks.astype(np.float32), 5, axis=0)
    approximate_design(big[:100], target)
    tracemalloc.start()
    approximate_design(big, target)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.5 * big.nbytes


def test_chunks_cover_all_candidates_once():
    blocks = some(50_000, 2, 3)
    stream = Blocks(blocks)
    parts = [part for part, _ in stream.chunks()]
    assert len(parts) > 1
    assert [i for part in parts for i in range(part.start, part.stop)] == list(range(50_000))
    factor = np.random.default_rng(1).normal(size=(3, 2))
    np.testing.assert_allclose(stream.sensitivities(factor), ((blocks @ factor) ** 2).sum(axis=(1, 2)))
    np.testing.assert_allclose(stream.gram(factor), np.einsum("nki,nkj->ij", blocks @ factor, blocks @ factor))


@pytest.mark.parametrize(("dtype", "near", "far"), [(np.float64, 1e-7, 1e-11), (np.float32, 1e-2, 1e-6)])
def test_rank_is_decided_with_unit_columns(dtype, near, far):
    # two nearly equal columns: seen as two down to 1e-9 (1e-4 in single precision), as one below
    for size, expected in ((near, 5), (far, 4)):
        blocks = some() * [1.0, 0.01, 30.0, 1.0, 1.0]
        blocks[..., 4] = blocks[..., 3] + size * blocks[..., 4]
        assert rank(blocks.astype(dtype)) == expected


@pytest.mark.parametrize("size", [1e-6, 1e-7, 3e-9])
def test_directions_that_one_gram_matrix_cannot_resolve_are_kept(size):
    blocks = some()
    blocks[..., 4] = blocks[..., 3] + size * blocks[..., 4]
    target = np.array([[0.0, 0.0, 0.0, 1.0, -1.0]])
    apart = np.concatenate([blocks[..., :4], ((blocks[..., 4] - blocks[..., 3]) / size)[..., None]], axis=2)
    expected = approximate_design(apart, np.array([[0.0, 0.0, 0.0, 1.0, -2.0 / size]])).value
    assert approximate_design(blocks, target).value == pytest.approx(expected, rel=1e-5)


def test_rounding_noise_is_not_information():
    blocks = some()
    blocks[..., 2] = 1e-16 * some(seed=1)[..., 0]
    assert rank(blocks) == 4
    with pytest.raises(NotIdentifiable) as caught:
        approximate_design(blocks, None, criterion="A")
    assert caught.value.missing == (2,)
    noisy = np.ones((1, 5)) * [1, 1, 1e-17, 1, 1]
    assert approximate_design(blocks, noisy).value > 0.0


def test_a_prior_counts_for_the_row_space():
    blocks = some()
    blocks[..., 2] = 0.0
    assert rank(blocks, np.diag([0, 0, 1e-6, 0, 0.0])) == 5
    design = approximate_design(blocks, None, criterion="A", prior=np.diag([0, 0, 4.0, 0, 0.0]))
    assert design.value == pytest.approx(
        approximate_design(blocks[..., [0, 1, 3, 4]], None, criterion="A").value + 0.25
    )


def test_the_reference_arm_has_rank_26():
    blocks, _ = reference_case(300, 26)
    assert rank(blocks) == 26
    assert rank(np.concatenate([blocks, blocks[..., :5] @ np.ones((5, 3))], axis=2)) == 26


@pytest.mark.parametrize("shape", [(50, 1, 1), (3, 1, 5), (4, 40, 6), (200, 1, 8), (1, 9, 4)])
def test_unusual_shapes(shape):
    blocks = some(*shape)
    target = (np.random.default_rng(3).normal(size=(1, shape[0] * shape[1])) @ blocks.reshape(-1, shape[2]))[:1]
    design = approximate_design(blocks, target)
    assert design.gap <= 1e-6
    weighted = np.einsum("n,nki,nkj->ij", design.weights, blocks, blocks)
    assert design.value == pytest.approx(value_of("test_pose", weighted, target), rel=1e-5)


def test_extreme_magnitudes_neither_overflow_nor_vanish():
    blocks, target = some(), np.ones((1, 5))
    plain = approximate_design(blocks, target).value
    for size in (1e-90, 1e90):
        assert approximate_design(blocks * size, target * size).value == pytest.approx(plain, rel=3e-6)


@pytest.mark.parametrize("usual", [0.0, 1e-3, 1.0])
def test_one_number_that_dwarfs_what_a_few_candidates_show(usual):
    """The sizes of the columns are first taken from a few candidates; this one is not among them."""
    blocks = some(5000, 3, 5)
    blocks[..., 2] *= usual
    blocks[4321, 1, 2] = 1e160  # its square overflows, and all else is rounding beside it
    assert rank(blocks) == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_first_bad_number_is_named(bad):
    blocks = some(5000, 3, 5)
    blocks[4321, 2, 1] = bad
    with pytest.raises(InputError, match=r"blocks\[4321, 2, 1\]"):
        approximate_design(blocks, np.ones((1, 5)))


def test_blocks_of_zeros_show_nothing():
    with pytest.raises(NotIdentifiable, match="zero"):
        approximate_design(np.zeros((4, 2, 3)), np.ones((1, 3)))
