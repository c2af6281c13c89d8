"""What the cameras do to the truth, and how often."""

import numpy as np
import pytest

from sim_twin.camera import Cameras

RATE, LATENCY, JITTER = 100.0, 0.020, 0.001  # of the shipped table
STATE = np.array([0.7, -0.4, 3.1, 0.1, 0.2, 0.3])


class Camera:
    """Cameras that see one body."""

    def __init__(self, mocap, seed):
        self._cameras = Cameras(["a"], mocap, seed)

    def expose(self, times, states):
        self._cameras.expose(times, states[:, None], -np.inf)

    def arrived(self, now):
        self._cameras.expose(np.empty(0), np.empty((0, 1, 6)), now)
        return self._cameras.arrived(0)


@pytest.fixture
def make_camera(make_table):
    def make(seed=3, **changes):
        never_lost = {"dropout_rate": 0.0}
        mocap = make_table(mocap=never_lost | changes).mocap
        return Camera(mocap, seed)

    return make


def frames(n):
    return np.arange(n) / RATE, np.tile(STATE, (n, 1))


def latencies(camera, n):
    """From exposure to the poll that finds it, every 0.1 ms, of `n` frames taken one by one."""
    times, states = frames(n)
    taken = []
    for k in range(n + 100):
        if k < n:
            camera.expose(times[k : k + 1], states[k : k + 1])
        for now in (100 * k + np.arange(100)) * 1e-4:
            taken += [now - sample.captured_at for sample in camera.arrived(now)]
    assert len(taken) == n
    return np.array(taken)


def test_a_perfect_camera_tells_the_truth_late(make_camera):
    camera = make_camera(noise=0.0, noise_deg=0.0, jitter_s=0.0)
    camera.expose(np.array([1.0]), STATE[None])
    assert camera.arrived(1.0 + LATENCY - 1e-9) == []
    (sample,) = camera.arrived(1.0 + LATENCY + 1e-9)
    assert (sample.captured_at, sample.x, sample.y) == (1.0, 0.7, -0.4)
    assert sample.theta == pytest.approx(3.1, abs=1e-15)
    assert camera.arrived(2.0) == []


def test_noise_is_what_the_file_says(make_camera):
    camera = make_camera(noise=0.0005, noise_deg=0.2)
    camera.expose(*frames(20_000))
    poses = np.array([(s.x, s.y, s.theta) for s in camera.arrived(np.inf)])
    # seen across the cut at pi, too
    assert (poses[:, 2] >= -np.pi).all()
    assert (poses[:, 2] < np.pi).all()
    error = poses - STATE[:3]
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    sigma = np.array([0.0005, 0.0005, np.radians(0.2)])
    assert np.abs(error.mean(axis=0) / sigma).max() < 0.03  # four standard errors
    assert error.std(axis=0) == pytest.approx(sigma, rel=0.02)
    assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 0.03
    assert np.abs(np.mean(error[1:] * error[:-1], axis=0) / sigma**2).max() < 0.03  # white


def test_heading_is_wrapped(make_camera):
    camera = make_camera(noise=0.0, noise_deg=0.0)
    states = np.tile(STATE, (3, 1))
    states[:, 2] = 3.5, -3.5, 40.0
    camera.expose(frames(3)[0], states)
    seen = sorted(camera.arrived(1.0), key=lambda sample: sample.captured_at)
    wanted = [3.5 - 2 * np.pi, 2 * np.pi - 3.5, 40.0 - 12 * np.pi]
    assert [sample.theta for sample in seen] == pytest.approx(wanted, abs=1e-12)


def test_latency_spreads_by_the_jitter(make_camera):
    latency = latencies(make_camera(), 3000)
    assert latency.mean() == pytest.approx(LATENCY + 0.5e-4, abs=1e-4)
    assert latency.std() == pytest.approx(JITTER, rel=0.06)


def test_nothing_arrives_before_half_the_latency(make_camera):
    latency = latencies(make_camera(jitter_s=0.05), 3000)
    assert latency.min() >= 0.5 * LATENCY - 1e-12
    assert (latency < 0.5 * LATENCY + 1.1e-4).mean() == pytest.approx(0.42, abs=0.04)  # Phi(-0.2)


def test_poses_come_in_order_of_arrival(make_camera):
    often, once = make_camera(jitter_s=0.02), make_camera(jitter_s=0.02)
    often.expose(*frames(500))
    once.expose(*frames(500))
    together = once.arrived(10.0)
    assert [s for now in np.arange(0.0, 10.0, 1e-3) for s in often.arrived(now)] == together
    captured = [sample.captured_at for sample in together]
    assert captured != sorted(captured)  # some overtook each other


def test_losses_are_as_frequent_and_as_long_as_the_file_says(make_camera):
    rate, mean, n = 2.0, 0.05, 200_000
    camera = make_camera(dropout_rate=rate, dropout_s=mean)
    camera.expose(*frames(n))
    seen = np.zeros(n, dtype=bool)
    seen[[round(s.captured_at * RATE) for s in camera.arrived(np.inf)]] = True
    # A loss of length d hides ceil(d rate) frames; d is exponential. Two may follow each other.
    enter = rate / RATE
    frames_hidden = 1.0 / (1.0 - np.exp(-1.0 / (RATE * mean)))
    between = (1.0 - enter) / enter
    share = frames_hidden / (frames_hidden + between)
    assert 1.0 - seen.mean() == pytest.approx(share, rel=0.08)
    begun = (seen[:-1] & ~seen[1:]).sum()
    assert begun == pytest.approx(n * (1.0 - share) * enter, rel=0.08)


def test_the_same_seed_sees_the_same(make_camera):
    views = []
    for seed in (1, 1, 2):
        camera = make_camera(seed, dropout_rate=1.0)
        camera.expose(*frames(300))
        views.append(camera.arrived(10.0))
    assert views[0] == views[1]
    assert views[0] != views[2]


@pytest.mark.parametrize("dropout_rate", [0.0, 5.0])
def test_what_is_seen_does_not_depend_on_how_often_one_looks(make_camera, dropout_rate):
    whole, pieces = make_camera(dropout_rate=dropout_rate), make_camera(dropout_rate=dropout_rate)
    times, states = frames(300)
    whole.expose(times, states)
    for part in np.split(np.arange(300), [10, 11, 100, 250]):
        pieces.expose(times[part], states[part])
    assert pieces.arrived(10.0) == whole.arrived(10.0)
