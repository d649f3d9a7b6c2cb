"""What must hold for every generated world, whatever the seed and the law."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.sim.environments.generated import (
    CEILING,
    EXCLUDED,
    HALF_WIDTH,
    HALO,
    LENGTH,
    _throw,
    clutter,
    cuboid_count,
    cuboids,
    draw_law,
    factory,
    farm,
    training,
)

GROUND = LENGTH * 2 * HALF_WIDTH - 2 * (2 * HALO) ** 2
seeds = st.integers(0, 10**7)
MOST_TRIED, MOST_KEPT = 500_000, 4_000
"""Places tried until a law is refused, and places among them with which each is compared."""
laws = st.sampled_from([(0.05, 6.0), (0.2, 10.0), (0.3, 10.0), (0.15, 4.0), (0.02, 1.0), (0.1, 3.0), (0.2, 20.0)])


def sparse(seed):
    return cuboids(seed, 0.05, 6.0)


def dense(seed):
    return cuboids(seed, 0.2, 10.0)


@pytest.mark.slow
@pytest.mark.parametrize("generator", (sparse, dense, factory, farm, clutter, training))
@given(seed=seeds)
def test_every_world_keeps_the_arena_and_frees_its_ends(generator, seed):
    world = generator(seed)
    assert (world.lower < world.upper).all()
    assert (world.lower >= (0.0, -HALF_WIDTH, 0.0)).all() and (world.upper <= (LENGTH, HALF_WIDTH, CEILING)).all()
    for end in (world.start, world.goal):
        assert ((end >= world.flight_lower) & (end <= world.flight_upper)).all()
    assert (world.clearance(np.stack([world.start, world.goal])) > 2.0).all()
    assert 95.0 < np.linalg.norm(world.goal - world.start) < 112.0
    assert abs(world.start[0] - 10.0) <= 2.0 and abs(world.goal[0] - 110.0) <= 2.0


@given(law=laws, seed=seeds)
def test_cuboids_meet_their_law(law, seed):
    density, side = law
    world = cuboids(seed, density, side)
    size = world.upper - world.lower
    np.testing.assert_allclose(size[:, :2], side)
    assert (size[:, 2] >= min(side, CEILING) - 1e-9).all()
    covered = len(size) * side**2
    assert abs(covered - density * GROUND) <= 0.5 * side**2 + 1e-9


@given(law=laws, seed=seeds)
def test_cuboids_leave_gaps_and_halos(law, seed):
    world = cuboids(seed, *law)
    gap = min(3.0, 0.5 * law[1])
    centre = 0.5 * (world.lower + world.upper)[:, :2]
    apart = np.abs(centre[:, None] - centre[None]).max(axis=-1) + np.diag(np.full(len(centre), np.inf))
    assert (apart >= law[1] + gap).all()
    for end in (world.start, world.goal):
        assert (np.abs(centre - end[:2]).max(axis=-1) >= 0.5 * law[1] + HALO).all()


@pytest.mark.parametrize("gap", (0.5, np.nan, "wide", True))
def test_a_gap_that_is_none_is_refused(gap):
    with pytest.raises(BadInputError, match="parameter 'gap'"):
        cuboids(1, 0.1, 10.0, gap)


@pytest.mark.slow
@given(density=st.floats(0.0, 1.0), side=st.floats(1.0, 60.0), seed=st.integers(0, 100))
def test_any_law_is_met_or_refused_at_once(density, side, seed):
    tried = []  # counted in the private function, since a world shows the places that were kept only

    def throw(darts, ends, halo, pitch, centres):
        tried.append(len(darts))
        assert len(centres) <= MOST_KEPT
        return _throw(darts, ends, halo, pitch, centres)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavfi.sim.environments.generated._throw", throw)
        try:
            world = cuboids(seed, density, side)
        except BadInputError as error:
            assert "density" in str(error) and "\n" not in str(error)
        else:
            assert tried and len(world.lower) == cuboid_count(density, side)
    assert sum(tried) <= MOST_TRIED


@given(density=st.floats(0.001, 0.2), side=st.floats(4.0, 12.0), seed=seeds)
def test_moderate_laws_are_always_met(density, side, seed):
    assume(density * (1.0 + min(3.0, 0.5 * side) / side) ** 2 < 0.4)
    assert len(cuboids(seed, density, side).lower) == cuboid_count(density, side)


@given(seed=seeds)
def test_training_never_draws_a_law_of_the_evaluation(seed):
    density, side = draw_law(seed)
    assert 0.03 <= density <= 0.22 and 4.0 <= side <= 10.0
    for excluded_density, excluded_side in EXCLUDED:
        assert abs(density - excluded_density) >= 0.015 or abs(side - excluded_side) >= 0.75


@given(seed=seeds)
def test_walls_of_the_factory_have_two_doors(seed):
    world = factory(seed)
    length = world.upper[:, 1] - world.lower[:, 1]
    thickness = world.upper[:, 0] - world.lower[:, 0]
    inner = np.isclose(thickness, 0.5) & (world.lower[:, 0] > 20.0) & (world.upper[:, 0] < 100.0)
    assert len(np.unique(world.lower[inner, 0])) == 3
    for x in np.unique(world.lower[inner, 0]):
        pieces = inner & (world.lower[:, 0] == x)
        assert pieces.sum() == 3
        assert 8.0 <= 2 * HALF_WIDTH - 1.0 - length[pieces].sum() <= 10.0


@given(seed=seeds)
def test_the_course_of_the_farm_is_free(seed):
    world = farm(seed)
    share = np.linspace(0.0, 1.0, 200)[:, None]
    assert world.clearance(world.start + share * (world.goal - world.start)).min() > 1.5
