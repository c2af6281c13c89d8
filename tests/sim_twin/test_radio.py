"""The wireless link against the closed forms of its own model."""

import numpy as np
import pytest

from sim_twin.radio import Radio, listen
from testbed.core.table import Link

CLEAN = Link(delay_s=0.0, jitter_s=0.0, loss=0.0, burst_loss=0.0, burst_enter=0.0, burst_leave=1.0)


class Channel:
    """A radio with one link."""

    def __init__(self, link, seed):
        self.radio = Radio(link, seed)
        self.row = self.radio.rows([("a", "b")])

    def send(self, t, message):
        self.radio.send(self.row, t, np.array([float(message)]))

    def newest(self, t):
        listen(self.radio.links, t)
        found = self.radio.newest("a", "b")
        return None if found is None else found[0]


@pytest.fixture
def make_channel():
    def make(seed=5, **changes):
        fields = {name: getattr(CLEAN, name) for name in Link.__struct_fields__}
        return Channel(Link(**fields | changes), seed)

    return make


def survivors(channel, n, start=0):
    """Which of `n` messages from `start` arrive, each sent when the one before has or is lost."""
    heard = np.zeros(n, dtype=bool)
    for k in range(n):
        channel.send(float(start + k), start + k)
        heard[k] = channel.newest(start + k + 0.5) == start + k
    return heard


def runs(flags):
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return edges[1::2] - edges[::2]


def test_nothing_is_heard_before_the_first_message(make_channel):
    assert make_channel().newest(1.0) is None


def test_a_message_takes_the_delay(make_channel):
    channel = make_channel(delay_s=0.005)
    channel.send(1.0, 7)
    assert channel.newest(1.00499) is None
    assert channel.newest(1.00501) == 7
    assert channel.newest(99.0) == 7  # however old


def test_jitter_adds_an_exponential_tail(make_channel):
    channel, delays = make_channel(delay_s=0.005, jitter_s=0.003), []
    for k in range(3000):
        channel.send(float(k), k)
        polls = k + np.arange(0.0, 0.08, 1e-4)
        delays.append(next(t - k for t in polls if channel.newest(t) == k))
    delays = np.array(delays)
    assert delays.min() >= 0.005
    assert delays.mean() == pytest.approx(0.008 + 0.5e-4, rel=0.03)
    assert delays.std() == pytest.approx(0.003, rel=0.08)


@pytest.mark.parametrize(
    ("loss", "burst_loss", "enter", "leave"),
    [(0.1, 0.1, 0.0, 1.0), (0.0, 1.0, 0.02, 0.2), (0.02, 0.6, 0.05, 0.3), (0.005, 0.5, 0.3, 0.05)],
)
def test_the_share_of_losses_is_that_of_the_stationary_chain(
    make_channel, loss, burst_loss, enter, leave
):
    n = 100_000
    channel = make_channel(loss=loss, burst_loss=burst_loss, burst_enter=enter, burst_leave=leave)
    bad = enter / (enter + leave)
    wanted = (1.0 - bad) * loss + bad * burst_loss
    # variance of the mean: that of coins, and that of a state remembered by 1 - enter - leave
    memory = (2.0 - enter - leave) / (enter + leave)
    variance = wanted * (1.0 - wanted) + bad * (1.0 - bad) * (burst_loss - loss) ** 2 * memory
    lost = 1.0 - survivors(channel, n).mean()
    assert lost == pytest.approx(wanted, abs=4.0 * np.sqrt(variance / n))


def test_losses_come_in_bursts(make_channel):
    channel = make_channel(burst_loss=1.0, burst_enter=0.02, burst_leave=0.2)
    lost = ~survivors(channel, 100_000)
    assert runs(lost).mean() == pytest.approx(1.0 / 0.2, rel=0.08)
    assert runs(~lost).mean() == pytest.approx(1.0 / 0.02, rel=0.08)


def test_the_newest_sent_wins_however_late_the_others_come(make_channel):
    channel, n = make_channel(jitter_s=0.05), 500
    heard = []
    for k in range(n):
        channel.send(0.001 * k, k)
        heard.append(channel.newest(0.001 * k))
    heard += [channel.newest(t) for t in np.arange(0.001 * n, 2.0, 0.001)]
    numbers = [message for message in heard if message is not None]
    assert numbers == sorted(numbers)
    assert numbers[-1] == n - 1
    assert len(set(numbers)) < 0.5 * n  # most were overtaken and are never heard


def test_the_same_seed_loses_the_same(make_channel):
    spoilt = {"loss": 0.3, "burst_loss": 0.9, "burst_enter": 0.1, "burst_leave": 0.3}
    first, again, other = (survivors(make_channel(seed, **spoilt), 300) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def test_an_injected_fault_changes_no_other_message(make_channel):
    spoilt = {"loss": 0.1, "burst_loss": 0.9, "burst_enter": 0.1, "burst_leave": 0.3}
    well, jammed = survivors(make_channel(**spoilt), 300), make_channel(**spoilt)
    for part, loss in ((slice(0, 100), 0.0), (slice(100, 200), 1.0), (slice(200, 300), 0.0)):
        jammed.radio.disturb("b", 0.0, loss)
        heard = survivors(jammed, 100, part.start)
        assert (heard == well[part]).all() if loss == 0.0 else not heard.any()


def test_a_late_message_waits_however_many_follow_it(make_channel):
    channel = make_channel(delay_s=0.005)
    channel.radio.disturb("b", 60.0, 0.0)
    for k in range(600):
        channel.send(0.1 * k, k)
    assert channel.newest(59.9) is None
    assert channel.newest(60.01) == 0
    assert channel.newest(90.06) == 300
    assert channel.newest(1e9) == 599


def test_links_keep_no_more_than_what_is_on_the_way(make_channel):
    channel = make_channel(delay_s=0.005)
    for k in range(2000):
        channel.send(0.1 * k, k)
        assert channel.newest(0.1 * k) == (k - 1 if k else None)
    assert channel.radio.links.waiting.shape == (16, 8, 1)


def test_a_longer_message_makes_room_and_loses_none(make_channel):
    radio = Radio(CLEAN, 1)
    row = radio.rows([("a", "b")])
    for size in (1, 5, 3):
        radio.send(row, 0.0, np.arange(float(size)))
        assert radio.newest("a", "b").tolist() == list(range(size))
