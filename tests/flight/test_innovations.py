"""The filter that believes the files: white innovations, and columns that are derivatives."""

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.flight import innovation_sums, innovations
from testbed.flight.estimator import EstimatorParams
from testbed.flight.fired import model_of
from testbed.flight.hypotheses import ALL, PUSHED, SPUN, WEAK, X, Y
from testbed.flight.jet_faults import known_of
from testbed.flight.memory import make_memory

FRAME, JETS = 0.01, 8
TINY = 1e-4  # size of a cause whose effect is compared with the column


class Flown:
    """A rigid body whose jets flow as told, integrated in small steps, and the filter beside it."""

    def __init__(self, vehicle, table, seed=0, noise=0.0, believed=None):
        self.model, self.believed = model_of(vehicle), model_of(believed or vehicle)
        self.p = known_of(vehicle, 0.1, EstimatorParams(), table).innovations
        memory, _ = make_memory(JETS, 4, 1, 1)
        self.m, self.sums = memory.fixed[0].jet_faults.innovations, memory.evidence.innovations
        self.flown, self.rng = memory.flown, np.random.default_rng(seed)
        self.noise = noise * np.sqrt(self.p.noise)[[0, 0, 1]]
        self.x, self.v, self.t = np.zeros(3), np.zeros(3), 0.0
        self.gives, self.leaks, self.push = np.ones(JETS), np.zeros(JETS), np.zeros(3)
        self.fly(np.zeros((1, JETS)))  # the first pose; every ten more are a look

    def fly(self, duties, steps=10):
        """Fly frames in which each jet flows at a constant share."""
        for duty in duties:
            h = FRAME / steps
            for _ in range(steps):
                c, s = np.cos(self.x[2]), np.sin(self.x[2])
                fx, fy, torque = self.model.effect @ (self.gives * duty + self.leaks * (1.0 - duty))
                a = np.array((c * fx - s * fy, s * fx + c * fy, 0.0)) / self.model.mass
                a[2] = torque / self.model.inertia
                drag = np.array((self.model.drag, self.model.drag, self.model.spin_drag))
                a += self.push - drag * self.v
                self.x, self.v = self.x + h * self.v + 0.5 * h * h * a, self.v + h * a
            self.t += FRAME
            self.flown[1] += FRAME * (self.flown[0] + 0.5 * FRAME * duty)
            self.flown[0] += FRAME * duty
            seen = self.x + self.noise * self.rng.standard_normal(3)
            innovations.update(
                self.p, self.m, self.sums, self.flown, self.believed, 1.0, np.array((self.t, *seen))
            )


def some(rng, frames):
    """Jets that flow for tenths of a second, one after the other."""
    return np.repeat((rng.random((frames // 10, JETS)) < 0.2).astype(float), 10, axis=0)


@pytest.mark.parametrize("spin_drag", [0.0, 0.9])
def test_without_noise_the_filter_follows_a_body_that_the_files_describe(spin_drag, vehicle, table):
    vehicle = replace(vehicle, drag=0.1 * vehicle.mass, spin_drag=spin_drag * vehicle.inertia)
    flown = Flown(vehicle, table)
    flown.fly(some(np.random.default_rng(1), 3000))
    assert np.abs(flown.m.x[:, 1] - flown.v).max() < 4e-4
    assert np.abs(flown.m.x[:, 2]).max() < 1e-3
    assert flown.m.squares / flown.m.remembered < 0.05  # of the noise that the file states


@pytest.mark.parametrize("seed", range(3))
def test_the_innovations_of_a_healthy_vehicle_are_as_noisy_as_the_files_say(seed, vehicle, table):
    vehicle = replace(vehicle, spin_drag=0.9 * vehicle.inertia)
    flown = Flown(vehicle, table, seed, noise=1.0)
    flown.fly(some(np.random.default_rng(seed), 6000))
    assert flown.m.squares / flown.m.remembered == pytest.approx(1.0, abs=0.1)
    assert flown.m.noise == pytest.approx(1.0, abs=0.1)
    assert max(flown.m.gains) < 9.0


def beliefs(vehicle):
    """Vehicle files that are wrong by TINY, by the place of the column that they change."""
    z, jets, (x, y) = 2 * JETS + 3, vehicle.jets, vehicle.com
    stronger = [replace(jet, thrust=jet.thrust * (1.0 + TINY)) for jet in jets]
    c, s = np.cos(TINY), np.sin(TINY)
    turned = [
        replace(jet, push=(c * jet.push[0] - s * jet.push[1], s * jet.push[0] + c * jet.push[1]))
        for jet in jets
    ]
    for j in range(JETS):
        yield j, replace(vehicle, jets=[*jets[:j], stronger[j], *jets[j + 1 :]])
        yield z + j, replace(vehicle, jets=[*jets[:j], stronger[j], *jets[j + 1 :]])
        yield JETS + j, replace(vehicle, jets=[*jets[:j], turned[j], *jets[j + 1 :]])
    yield 2 * JETS, replace(vehicle, inertia=vehicle.inertia / (1.0 + TINY))
    yield 2 * JETS + 1, replace(vehicle, com=(x + TINY, y))
    yield 2 * JETS + 2, replace(vehicle, com=(x, y + TINY))
    yield z + 2 * JETS + ALL, replace(vehicle, jets=stronger)
    lighter, less = vehicle.mass / (1.0 + TINY), vehicle.drag / (1.0 + TINY)
    yield z + 2 * JETS + PUSHED, replace(vehicle, mass=lighter, drag=less)


def column(flown, place):
    """What a parameter or a cause since the start changes: position, velocity, acceleration."""
    z = 2 * JETS + 3
    if place < z:
        return flown.sums.sure[:, :, place]
    return flown.sums.moved[:, :, place - z]


def test_a_column_is_what_the_filter_changes_if_it_believes_the_cause(vehicle, table):
    vehicle = replace(
        vehicle, com=(0.01, 0.0), drag=0.1 * vehicle.mass, spin_drag=0.5 * vehicle.inertia
    )
    duties = some(np.random.default_rng(2), 800)
    known = Flown(vehicle, table)
    known.fly(duties)
    for place, believed in beliefs(vehicle):
        other = Flown(vehicle, table, believed=believed)
        other.fly(duties)
        expected = column(known, place)
        near = 0.03 * np.abs(expected).max(axis=0)
        changed = (other.m.x - known.m.x) / TINY
        assert (np.abs(changed - expected) < near + 0.03 * np.abs(expected)).all(), place


@pytest.mark.parametrize(("axis", "cause"), [(0, X), (1, Y), (2, SPUN)])
def test_the_column_of_a_pull_is_what_the_filter_does_not_know_of_it(axis, cause, vehicle, table):
    duties = some(np.random.default_rng(2), 300)
    known, pulled = Flown(vehicle, table), Flown(vehicle, table)
    pulled.push[axis] = TINY
    known.fly(duties)
    pulled.fly(duties)
    moved = (pulled.x - known.x)[axis], (pulled.v - known.v)[axis]
    expected = column(known, 2 * JETS + 3 + 2 * JETS + cause)[axis]
    for k in range(2):
        unknown = (moved[k] - (pulled.m.x - known.m.x)[axis, k]) / TINY
        assert unknown == pytest.approx(expected[k], rel=0.02, abs=1e-3 * moved[k] / TINY)


@pytest.mark.parametrize("jet", range(0, JETS, 3))
def test_a_jet_that_loses_a_third_is_named_within_a_second_of_its_use(jet, vehicle, table):
    rng = np.random.default_rng(jet)
    flown = Flown(vehicle, table, jet, noise=1.0)
    flown.gives = 1.0 + 0.04 * rng.standard_normal(JETS)
    flown.fly(some(rng, 1500))
    assert flown.m.weak.gain < 9.2
    flown.gives[jet] *= 0.7
    asked = 0.0
    while asked < 1.0:
        duties = some(rng, 50)
        asked += FRAME * duties[:, jet].sum()
        flown.fly(duties)
    weak = flown.m.weak
    assert (weak.jet, weak.gain > 9.2) == (jet, True)
    assert weak.share == pytest.approx(0.3, abs=0.07)
    assert weak.gain == max(flown.m.gains)
    assert flown.m.gains[WEAK] == weak.gain


def test_the_beginning_of_the_best_cause_stays_for_as_long_as_it_is_the_best(vehicle, table):
    rng = np.random.default_rng(5)
    flown = Flown(vehicle, table, 5, noise=1.0)
    flown.fly(some(rng, 1000))
    flown.gives[2] = 0.6
    flown.fly(some(rng, 200))
    shares = []
    for _ in range(30):
        flown.fly(some(rng, 100))
        assert flown.m.weak.jet == 2
        shares.append(float(flown.m.weak.share))
    assert np.ptp(shares) < 0.04
    assert np.mean(shares) == pytest.approx(0.4, abs=0.05)


def test_poses_after_a_gap_start_the_filter_again_and_what_was_heard_stays(vehicle, table):
    flown = Flown(vehicle, table, 1, noise=1.0)
    flown.fly(some(np.random.default_rng(1), 500))
    heard, spread = float(flown.m.remembered), np.diag(flown.sums.cov).copy()
    flown.x, flown.v = flown.x + 0.5, flown.v + 0.05  # something pushed it meanwhile
    flown.t += 2.0
    flown.fly(np.zeros((200, JETS)))
    assert flown.m.remembered > heard
    assert max(flown.m.gains) < 9.0
    assert (np.diag(flown.sums.cov) < 1.2 * spread).all()


def test_a_push_from_outside_does_not_count(vehicle, table):
    flown = Flown(vehicle, table, 1, noise=1.0)
    flown.fly(some(np.random.default_rng(1), 1000))
    flown.v = flown.v + np.array((0.1, 0.0, 0.2))
    flown.fly(some(np.random.default_rng(2), 300))
    assert max(flown.m.gains) < 9.0
    assert np.abs(flown.m.x[:, 1] - flown.v).max() < 2e-3


def test_a_weak_jet_counts_the_looks_in_which_it_fires_and_is_likely(vehicle, table):
    rng = np.random.default_rng(5)
    flown = Flown(vehicle, table, 5, noise=1.0)
    flown.fly(some(rng, 1000))
    assert flown.m.held == 0
    flown.gives[2] = 0.5
    flown.fly(some(rng, 400))
    first, duties = int(flown.m.held), some(rng, 200)
    flown.fly(duties)
    fired = int((duties.reshape(-1, 10, JETS)[:, :, 2].sum(axis=1) > 0.0).sum())
    assert 0 < first < int(flown.m.held) == first + fired
    innovations.pause(flown.m)
    assert flown.m.held == 0


def test_what_a_cause_changes_since_a_beginning_is_what_it_would_without_a_past(vehicle, table):
    rng = np.random.default_rng(4)
    before, after = some(rng, 300), some(rng, 50)
    flown, other = Flown(vehicle, table, 4, 1.0), Flown(vehicle, table, 4, 1.0)
    flown.fly(before)
    other.fly(before)
    other.sums.moved[:] = 0.0
    place = (int(flown.m.looks) + 1) % innovation_sums.RECENT
    flown.fly(after)
    other.fly(after)
    fades = flown.sums.fades.reshape(3, 3, innovation_sums.BEGINNINGS, 3)[:, :, place]
    since = flown.sums.moved - np.einsum("aik,akc->aic", fades, flown.sums.before[place])
    assert np.abs(flown.sums.before[place]).max() > 0.1
    assert since == pytest.approx(other.sums.moved, abs=1e-9)


def test_the_sums_are_those_of_all_innovations_at_once(vehicle, table):
    """Generalized least squares: V is the covariance of all innovations, by noise and z."""
    rng, looks = np.random.default_rng(3), 25
    p = known_of(vehicle, 0.1, EstimatorParams(), table).innovations
    memory, _ = make_memory(JETS, 4, 1, 1)
    sums = memory.evidence.innovations
    innovation_sums.clear(p, sums)
    m, count = sums.cov.shape[0], sums.scores.shape[2]
    acts = np.zeros((looks, 3, 3, m + count))
    acts[:, :, 2] = rng.normal(size=(looks, 3, m + count))  # only the look's own mean pose
    errors, noises = rng.normal(size=(looks, 3)), rng.uniform(0.5, 2.0, (looks, 3))
    noises[7, 1] = np.inf
    nothing = np.zeros((3, 2)), np.zeros((3, 3)), np.zeros((3, 3))
    heard = innovation_sums.Look(
        *nothing, np.empty((3, m)), np.empty((3, m)), np.empty(3), np.empty(3)
    )
    for look, act in enumerate(acts):
        for axis in range(3):
            error, noise = errors[look, axis], noises[look, axis]
            innovation_sums.learn(sums, heard, axis, act[axis], error, noise)
        innovation_sums.add(sums, heard, act)
    counts = np.isfinite(noises)
    z, causes = acts[:, :, 2, :m][counts], acts[:, :, 2, m:][counts]
    least = np.linalg.inv(np.diag(noises[counts]) + z @ np.diag(1.0 / p.sure) @ z.T)
    own = np.einsum("ij,ik,kj->j", causes, least, causes)
    fits = causes.T @ least @ errors[counts]
    assert sums.scores[0, 0] == pytest.approx(own, rel=1e-9)
    assert sums.scores[0, 1] == pytest.approx(fits, rel=1e-9, abs=1e-9 * np.abs(fits).max())
    assert sums.z == pytest.approx((z.T @ least @ errors[counts]) / p.sure, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("jet", range(0, JETS, 3))
def test_the_whole_thrust_of_an_open_jet_is_heard_to_its_size(jet, vehicle, table):
    """The filter lags behind such a push by more than jets can push within a look."""
    rng = np.random.default_rng(jet)
    flown = Flown(vehicle, table, jet, noise=1.0)
    flown.fly(some(rng, 1000))
    heard = float(flown.m.remembered)
    flown.leaks[jet] = 1.0
    flown.fly(np.zeros((100, JETS)))
    assert flown.m.leak.jet == jet
    assert flown.m.leak.share == pytest.approx(1.0, abs=0.1)
    heard *= 1.0 - 1.0 / innovations.MEMORY_S  # a second later
    assert flown.m.remembered == pytest.approx(heard + 30.0, abs=2.0)  # ten looks, three axes
    assert flown.m.leak_held > 1


def test_a_jet_whose_leak_the_filter_knows_leaves_white_innovations(vehicle, table):
    flown = Flown(vehicle, table, 1, noise=1.0)
    flown.gives[1], flown.sums.gives[1] = 0.7, 0.7
    flown.leaks[2] = flown.sums.leaks[2] = 0.4
    rng = np.random.default_rng(1)
    flown.fly(some(rng, 6000))
    assert flown.m.squares / flown.m.remembered == pytest.approx(1.0, abs=0.1)
    assert max(flown.m.gains) < 9.0
