"""The search behind `reach`, on a planar arm of stiff links, which has a closed form: SciPy's solvers find the same."""

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from cosserat_jax.study.inverse.box_least_squares import Effort, Images, closest
from cosserat_jax.study.inverse.multistart import best_of, grid, starts

LINKS, WIDTH = np.array([0.5, 0.3, 0.2]), 2.0  # the angles of the joints are -1 to 1 rad
EFFORT = Effort(np.full(3, -1.0), np.full(3, WIDTH))  # the squared angles


def imaging(u: np.ndarray) -> Images:
    """The tip of the links at the angles -1 + 2 u, cumulative."""
    angle = np.cumsum(-1 + WIDTH * u, axis=-1)
    rates = np.stack([-LINKS * np.sin(angle), LINKS * np.cos(angle)], axis=1)
    jacobian = WIDTH * np.cumsum(rates[..., ::-1], axis=-1)[..., ::-1]
    r = np.stack([LINKS * np.cos(angle), LINKS * np.sin(angle)], axis=1).sum(axis=-1)
    return Images(r, jacobian, np.ones(len(u), bool))


def only_left(u: np.ndarray) -> Images:
    """No image where the first joint turns beyond 0.2 rad."""
    images = imaging(u)
    exists = u[:, 0] <= 0.6
    return Images(np.where(exists[:, None], images.r, np.nan), images.jacobian, exists)


def drawn(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Places whose images are targets that can be reached, and of a grid those with the nearest images."""
    places = np.random.default_rng(5).uniform(size=(number, 3))
    box, _ = grid(3, 216)
    apart = np.linalg.norm(imaging(box).r[None] - imaging(places).r[:, None], axis=-1)
    return box[apart.argmin(axis=1)], places


def test_every_target_that_can_be_reached_is_reached_within_the_bounds():
    _, places = drawn(200)
    targets, (box, shape) = imaging(places).r, grid(3, 216)
    owner, begin = starts(targets, box, shape, imaging(box), EFFORT)
    found = closest(imaging, targets[owner], begin, EFFORT)
    best = best_of(found, owner, len(targets), EFFORT, 1e-11)
    np.testing.assert_allclose(found.distance[best], 0.0, atol=1e-11)
    assert ((found.u >= 0) & (found.u <= 1)).all()
    assert (EFFORT.of(found.u[best]) <= EFFORT.of(places) * (1 + 1e-9)).all()
    assert np.median(found.iterations[best]) < 20
    assert not found.exhausted[best].any()


def test_of_all_that_reach_it_has_least_effort():
    begin, places = drawn(30)
    targets = imaging(places).r
    found = closest(imaging, targets, begin, EFFORT)
    for target, u in zip(targets, found.u, strict=True):
        constraint = {
            "type": "eq",
            "fun": lambda v, target=target: imaging(v[None]).r[0] - target,
            "jac": lambda v: imaging(v[None]).jacobian[0],
        }
        slsqp = minimize(
            EFFORT.of, u, jac=lambda v: 2 * EFFORT.b * EFFORT.weights(v), method="SLSQP", constraints=constraint,
            bounds=[(0, 1)] * 3, options={"ftol": 1e-15, "maxiter": 200},
        )  # fmt: skip
        assert float(EFFORT.of(u)) == pytest.approx(slsqp.fun, rel=1e-6)


def test_out_of_reach_it_finds_the_nearest_point():
    begin, places = drawn(30)
    targets = 1.7 * imaging(places).r
    found = closest(imaging, targets, begin, EFFORT)
    assert found.settled.all()
    for target, start, distance in zip(targets, found.u, found.distance, strict=True):
        trf = least_squares(
            lambda v, target=target: imaging(v[None]).r[0] - target, np.clip(start, 1e-6, 1 - 1e-6),
            lambda v: imaging(v[None]).jacobian[0], bounds=(0, 1), xtol=1e-15, ftol=1e-15, gtol=1e-15,
        )  # fmt: skip
        assert distance <= np.sqrt(2 * trf.cost) + 1e-9


def test_a_search_stays_where_there_are_images():
    begin, places = drawn(60)
    begin[:, 0] *= 0.6
    found = closest(only_left, imaging(places).r, begin, EFFORT)
    assert np.isfinite(found.error).all()
    assert (found.u[:, 0] <= 0.6).all()
    there = found.distance < 1e-11
    assert 0.3 < there.mean() < 1
    assert (found.settled | found.lost)[~there].all()
