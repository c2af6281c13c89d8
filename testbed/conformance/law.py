"""What the testbed requires of a law: shapes, finite numbers, no side effects, no hidden state.

A law is asked in scenes that flights have: on the way, at rest in its goal, close to an obstacle,
alone, with others of whom nothing was heard but where they are. What it remembers belongs into the
law's state. Equal inputs give equal outputs, independent of calls in between: replay needs it.
"""

import reprlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from controllers.law_file import LawError, UnusableLawError
from controllers.own_law import law_of
from testbed.conformance.check import NotConformingError, factory_of, must, run_all
from testbed.core.error import TestbedError
from testbed.core.law import Array, Body, Discs, Goal, Law, Neighbours, World

SATELLITES = ("sat1", "sat2", "sat3")
SECONDS, STEPS = 0.1, 4  # of a look ahead
SCENES = 6  # drawn ones, beside the extremes


class Situation(NamedTuple):
    """Arguments for a law."""

    own: Body
    neighbours: Neighbours
    world: World
    t: float  # [s]


class LawConformance:
    """Subclass it in a test file: `class TestMine(LawConformance): make = Springs`.

    Attributes:
        make: the class or function that the entry point names.
        parameters: that it is called with, as an experiment would.
        dimensions: of the positions that it must take; 2 is the table, 3 is orbit.
    """

    make: Callable[..., Any]
    parameters: dict[str, Any] = {}  # noqa: RUF012  (an author replaces it, nothing fills it)
    dimensions: tuple[int, ...] = (2,)

    def _law(self, d: int) -> Law:
        try:
            return law_of(factory_of(self), self.parameters, SATELLITES, d)
        except UnusableLawError as error:
            raise NotConformingError("the law", "one that can be made", str(error)) from error

    def _asked(self) -> Iterator[tuple[Law, Situation]]:
        for d in self.dimensions:
            law = self._law(d)
            for scene in scenes(d, law.message_size):
                yield law, scene

    def test_shapes(self) -> None:
        """A force (d,), a rate as long as the state, and `message_size` numbers to broadcast."""
        for law, scene in self._asked():
            d, here = len(scene.own.p), _at(scene)
            state = _initial(law, scene)
            must(state.ndim == 1, f"initial {here}", "a state of shape (n,)", state.shape)
            force, rate = _rate(law, state, scene)
            must(force.shape == (d,), f"force {here}", f"shape ({d},)", force.shape)
            must(rate.shape == state.shape, f"rate {here}", f"shape {state.shape}", rate.shape)
            ahead = _ahead(law, state, scene)
            for name, shape in (
                ("law_state", state.shape), ("p", (d,)), ("v", (d,)),
                ("mean_force", (d,)), ("message", (law.message_size,)),
            ):  # fmt: skip
                found = np.shape(getattr(ahead, name))
                must(found == shape, f"{name} of propagate {here}", f"shape {shape}", found)

    def test_finite_numbers(self) -> None:
        """No scene makes a force that is not a number."""
        for law, scene in self._asked():
            state = _initial(law, scene)
            numbers = {
                "initial": state,
                **dict(zip(("force", "rate"), _rate(law, state, scene), strict=True)),
                **_ahead(law, state, scene)._asdict(),
            }
            for name, values in numbers.items():
                must(np.isfinite(values).all(), f"{name} {_at(scene)}", "finite numbers", values)

    def test_inputs_are_not_written(self) -> None:
        """The arrays belong to the caller."""
        for law, scene in self._asked():
            state = np.array(_initial(law, scene))
            before = _numbers((scene, state))
            for ask in (_initial_twice, _rate, _ahead):
                ask(law, state, scene)
                name = ask.__name__.strip("_")
                same = all(map(np.array_equal, before, _numbers((scene, state))))
                must(same, f"{name} {_at(scene)}", "inputs that are only read", "one was written")

    def test_same_question_same_answer(self) -> None:
        """Equal inputs give equal outputs to the last bit, with other calls in between."""
        for d in self.dimensions:
            law = self._law(d)
            asked = list(scenes(d, law.message_size))
            first = [_answer(law, scene) for scene in asked]
            again = [_answer(law, scene) for scene in reversed(asked)][::-1]
            for scene, one, other in zip(asked, first, again, strict=True):
                expected = "the same answer to the same question: memory is the law's state"
                must(_same(one, other), f"a law asked twice {_at(scene)}", expected, "another")

    def test_two_laws_are_alike(self) -> None:
        """A second instance, for another vehicle or run, gives the same outputs."""
        for d in self.dimensions:
            law = self._law(d)
            first = [_answer(law, scene) for scene in scenes(d, law.message_size)]
            for k in range(2):
                other = self._law(d)
                for scene, one in zip(scenes(d, law.message_size), first, strict=True):
                    what = f"law number {k + 2} of the same parameters {_at(scene)}"
                    expected = "the answer of the first: nothing outside it is kept or drawn"
                    must(_same(one, _answer(other, scene)), what, expected, "another")


def check_law(
    factory: Callable[..., Any],
    parameters: dict[str, Any] | None = None,
    dimensions: tuple[int, ...] = (2,),
) -> None:
    """All checks of `LawConformance`, without pytest.

    Raises:
        NotConformingError: the first that fails.
        TestbedError: `parameters` or `dimensions` are of another kind.
    """
    asked = list(dimensions) if isinstance(dimensions, tuple | list) else []
    if not asked or not all(isinstance(one, int) and one in (2, 3) for one in asked):
        expected = "(2,), (3,) or (2, 3): of the table, of orbit, or both"
        where = "check_law, dimensions"
        raise TestbedError(where=where, expected=expected, found=repr(dimensions))
    if not isinstance(parameters, Mapping | None):
        expected, found = 'values by name: {"stiffness": 0.3}', reprlib.repr(parameters)
        raise TestbedError(where="check_law, parameters", expected=expected, found=found)
    suite = LawConformance()
    suite.__dict__.update(make=factory, parameters=parameters or {}, dimensions=dimensions)
    run_all(suite)


def scenes(d: int, words: int) -> Iterator[Situation]:
    """Situations of a flight for positions of shape (d,), of others who say so many words."""
    rng = np.random.default_rng(20)
    for k in range(SCENES):
        yield _scene(rng, d, words, others=k % 3, obstacles=k % 2, moving=True, t=1.7 * k)
    still = _scene(rng, d, words, others=0, obstacles=0, moving=False, t=0.0)
    yield still  # alone, at rest
    goal = still.world.goal._replace(p=still.own.p.copy())
    yield still._replace(world=still.world._replace(goal=goal))  # and there
    near = _scene(rng, d, words, others=2, obstacles=1, moving=False, t=90.0)
    at = near.world.obstacles.p[0]
    aside = np.zeros(d)
    aside[0] = near.world.obstacles.radius[0]
    yield near._replace(own=near.own._replace(p=at + aside))  # at the edge of an obstacle
    yield near._replace(own=near.own._replace(p=at + 0.9 * aside))  # within it


def _scene(
    rng: np.random.Generator,
    d: int,
    words: int,
    *,
    others: int,
    obstacles: int,
    moving: bool,
    t: float,
) -> Situation:
    def vectors(n: int, reach: float) -> Array:
        return rng.uniform(-reach, reach, (n, d))

    pace = 0.05 if moving else 0.0
    own = Body(
        vectors(1, 2.5)[0], vectors(1, pace)[0], 12.0, vectors(1, 0.02 * pace)[0],
        np.zeros(d), 0.6, 0,
    )  # fmt: skip
    goal = Goal(vectors(1, 2.5)[0], vectors(1, pace)[0], np.zeros(d), np.zeros(d))
    around = Neighbours(
        vectors(others, 2.5), vectors(others, pace), np.full(others, 0.5),
        np.arange(1, others + 1), np.zeros((others, words)), np.full(others, t),
    )  # fmt: skip
    return Situation(
        own,
        around,
        World(
            goal, Discs(vectors(obstacles, 2.5), vectors(obstacles, 0.0), np.full(obstacles, 0.4))
        ),
        t,
    )


def _at(scene: Situation) -> str:
    n, obstacles = len(scene.neighbours.radius), len(scene.world.obstacles.radius)
    return f"(at {np.round(scene.own.p, 2)}, {n} neighbours, {obstacles} obstacles, {scene.t:g} s)"


def _ask_law(ask: Callable[[], Any], what: str, scene: Situation) -> Any:
    try:
        return ask()
    except (LawError, ArithmeticError) as error:
        raise NotConformingError(f"{what} {_at(scene)}", "an answer", str(error)) from error


def _initial(law: Law, scene: Situation) -> Array:
    ask = lambda: np.asarray(law.initial(scene.own, scene.neighbours, scene.world))  # noqa: E731
    found: Array = _ask_law(ask, "initial", scene)
    return found


def _initial_twice(law: Law, state: Array, scene: Situation) -> None:
    _initial(law, scene)


def _rate(law: Law, state: Array, scene: Situation) -> tuple[Array, Array]:
    ask = lambda: law.rate(state, *scene)  # noqa: E731
    force, rate = _ask_law(ask, "rate", scene)
    return np.asarray(force), np.asarray(rate)


def _ahead(law: Law, state: Array, scene: Situation) -> Any:
    return _ask_law(lambda: law.propagate(state, *scene, SECONDS, STEPS), "propagate", scene)


def _answer(law: Law, scene: Situation) -> list[Array]:
    state = _initial(law, scene)
    return [np.array(x) for x in (state, *_rate(law, state, scene), *_ahead(law, state, scene))]


def _same(one: list[Array], other: list[Array]) -> bool:
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


def _numbers(nested: Any) -> list[Array]:
    """Copies of all arrays and numbers in tuples in each other."""
    if isinstance(nested, tuple):
        return [one for part in nested for one in _numbers(part)]
    return [np.array(nested)]
