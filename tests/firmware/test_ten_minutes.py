"""Ten minutes of everything that can go wrong at once, seen from outside: bytes, answers, edges.

The observer knows only what the sender sent and what the board answered. It does not know how the
firmware works, so it can say what must never happen, not what must.
"""

from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from firmware_interface.frame import encode_message
from firmware_interface.messages import (
    Ack,
    Arm,
    Bearing,
    Cmd,
    Disarm,
    Fault,
    Hello,
    HelloAck,
    Ping,
    ResetCause,
    Result,
    State,
    Status,
)

MINUTE = 60_000_000
NEVER = 1 << 62
COUNTERS = (
    *("bad_length", "bad_crc", "foreign", "replayed", "refused"),
    *("watchdog_trips", "unplayed", "cut_max_on", "cut_duty"),
)
TAKEN = (Result.OK, Result.REFRESHED)


@dataclass
class Observer:
    """What may be open, and whether what is open may."""

    limits: object
    armed: bool = False
    fed_us: int = 0
    low_since_us: int = NEVER
    pulses: list = field(default_factory=lambda: [(0, 0)] * 8)  # (from, to) of the newest plan
    mask: int = 0
    opened: list = field(default_factory=lambda: [None] * 8)
    openings: list = field(default_factory=lambda: [[] for _ in range(8)])  # [up, down]

    def stop(self):
        self.armed, self.pulses = False, [(0, 0)] * 8

    def heard(self, ack, sent, now):
        """An answer to `sent`."""
        assert not ack.faults & Fault.INTERLOCK, "the output stage had to step in"
        if isinstance(sent, Disarm):
            self.stop()
        elif isinstance(sent, Arm) and ack.result == Result.OK and not self.armed:
            self.armed, self.fed_us = True, now
        elif isinstance(sent, Cmd) and ack.result in TAKEN:
            assert self.armed
            self.fed_us = now
            if ack.result == Result.OK:
                start, end = now - sent.age_us, now - sent.age_us + sent.ttl_us
                self.pulses = [
                    (max(now, start + offset), min(end, start + offset + on))
                    for on, offset in zip(sent.on_us, sent.offset_us, strict=True)
                ]

    def supply(self, millivolts, now):
        if millivolts >= self.limits.undervoltage_mv:
            self.low_since_us = NEVER
        elif self.low_since_us == NEVER:
            self.low_since_us = now

    def passed(self, edges, begin, end):
        """Check the time from `begin` to `end`, in which nothing was sent."""
        trip = min(
            self.fed_us + self.limits.watchdog_us,
            max(begin, self.low_since_us + self.limits.undervoltage_us),
        )
        changes = [(begin, self.mask), *edges, (end, None)]
        for (since, mask), (until, _) in pairwise(changes):
            if mask and until > since:
                self.may_be_open(mask, since, until, trip)
        for at, mask in edges:
            self.turned(at, mask)
        if trip <= end:
            self.stop()

    def may_be_open(self, mask, since, until, trip):
        assert self.armed, f"open at {since} us though not armed"
        assert until <= trip, f"open from {since} to {until} us, past {trip} us"
        for valve in range(8):
            if mask >> valve & 1:
                start, end = self.pulses[valve]
                assert start <= since, f"V{valve} opens at {since} us, asked for from {start} us"
                assert until <= end, f"V{valve} closes at {until} us, asked for until {end} us"
                assert not mask & self.limits.opposing[valve], f"V{valve} and its opposite"

    def turned(self, at, mask):
        for valve in range(8):
            was, now = self.mask >> valve & 1, mask >> valve & 1
            history = self.openings[valve]
            if now > was and (not history or history[-1][1] != at):  # else it went on
                self.opens(valve, at)
                history.append([at, None])
            elif now > was:
                history[-1][1] = None
            elif now < was:
                history[-1][1] = at
                assert at - history[-1][0] <= self.limits.max_on_us, f"V{valve} open for too long"
        self.mask = mask

    def opens(self, valve, at):
        for other in range(8):
            gap = self.limits.min_off_us if other == valve else 0
            if self.limits.opposing[valve] >> other & 1:
                gap = self.limits.dead_us
            if gap and self.openings[other]:
                closed = self.openings[other][-1][1]
                assert closed is not None, f"V{valve} opens against V{other}"
                assert at - closed >= gap, f"V{valve} opens {at - closed} us after V{other} closed"

    def most_open_us(self, valve):
        """Open time in the worst window of the duty limit; a worst one ends with an opening."""
        history = np.array([pulse for pulse in self.openings[valve] if pulse[1]]).reshape(-1, 2)
        before = np.concatenate([[0], np.cumsum(history[:, 1] - history[:, 0])])
        worst = 0
        for number, end in enumerate(history[:, 1]):
            start = end - self.limits.duty_window_us
            first = np.searchsorted(history[:, 1], start)
            cut = max(0, start - history[first, 0])
            worst = max(worst, before[number + 1] - before[first] - cut)
        return worst


class Sender:
    """A sender in changing moods, over a bad line."""

    def __init__(self, host, rng, seen):
        self.host, self.rng, self.seen = host, rng, seen
        self.number = 0
        self.last = b""
        self.newest = None
        self.sent = {}  # by sequence number
        self.mood()

    def mood(self):
        rng = self.rng
        self.eager = rng.random(8) * rng.choice([0.5, 1.0, 3.0])
        self.loss = rng.choice([0.0, 0.1, 0.5])
        self.calm = rng.random() < 0.5
        self.left = int(rng.integers(20, 300))

    def plan(self):
        rng, host = self.rng, self.host
        period = 100_000
        wanted = rng.random(8) < self.eager
        full = rng.random(8) < np.maximum(0.5, self.eager - 0.5)
        on = np.where(full, period, rng.integers(0, period, 8)) * wanted
        offset = np.where(full | (rng.random(8) < 0.5), 0, rng.integers(0, 50_000, 8))
        if rng.random() < 0.95:  # else opposing pairs are asked for, and refused
            for valve in range(8):
                for other in range(valve):
                    if host.limits.opposing[valve] >> other & 1:
                        on[min((other, valve), key=lambda v: self.eager[v])] = 0
        if rng.random() < 0.02:
            on[int(rng.integers(8))] = int(rng.choice([400_009, 400_010, 10_000_000, 1]))
        self.number += int(rng.choice([1, 1, 1, 1, 5, 0, -1]))
        age = int(rng.choice([0, 0, 0, rng.integers(0, 60_000)]))
        ttl = int(
            rng.choice([120_000, 150_000, 150_000, period, rng.integers(1, 900_001), 900_002])
        )
        return Cmd(
            host.session, self.number % (1 << 32), age, ttl,
            tuple(on.tolist()), tuple(offset.tolist()),
        )  # fmt: skip

    def message(self):
        rng, session = self.rng, self.host.session
        sort = rng.random()
        if not self.seen.armed and sort < 0.8:
            return Arm(session)
        if sort < 0.7 and self.newest:
            return self.newest
        if sort < 0.97 or self.calm:
            self.newest = self.plan()
            return self.newest
        others = (Arm(session), Disarm(), Hello(7), Ping(), Bearing(session, 1), Arm(session + 1))
        return others[int(rng.integers(len(others)))]

    def send(self):
        """One frame, or what became of it."""
        rng, host = self.rng, self.host
        self.left -= 1
        if self.left == 0:
            self.mood()
        message = self.message()
        host.seq = (host.seq + 1) & 0xFFFF
        frame = encode_message(message, host.seq, host.board.now_us)
        sort = rng.random()
        self.sent[host.seq] = message  # even a cut frame may be completed by a later delimiter
        if not self.calm and rng.random() < self.loss:
            return
        if self.calm or sort > 0.13:
            host.board.feed(b"\0" + frame)  # whatever is left of garbage ends here
            self.last = frame
        elif sort < 0.05:
            spoilt = bytearray(frame)
            spoilt[int(rng.integers(len(frame)))] ^= 1 << int(rng.integers(8))
            host.board.feed(bytes(spoilt))
        elif sort < 0.08:
            host.board.feed(frame[: int(rng.integers(len(frame)))])
        elif sort < 0.11:
            host.board.feed(rng.bytes(int(rng.integers(1, 200))))
        else:
            host.board.feed(self.last)


def soak(host, seen, rng, until_us):
    sender = Sender(host, rng, seen)
    mv = host.limits.undervoltage_mv
    while host.board.now_us < until_us:
        begin = host.board.now_us
        if rng.random() < 0.005:
            volts = int(rng.choice([mv - 1, mv, mv + 5_000, mv + 6_000]))
            host.board.sense(volts, 500_000)
            seen.supply(volts, begin)
        sender.send()
        for message in host.listen():
            if isinstance(message, HelloAck):
                host.session = message.session
                seen.stop()
            elif isinstance(message, Ack):
                seen.heard(message, sender.sent[message.seq], begin)
            elif isinstance(message, Status):
                host.status = message
        wait = int(rng.integers(5_000, 30_000))
        if not sender.calm:
            wait = int(rng.choice([wait, 2 * wait, 0, 300_000], p=[0.5, 0.39, 0.1, 0.01]))
        end = min(until_us, begin + wait)
        edges = [(edge.t_us, edge.mask) for edge in host.board.run_until(end)]
        seen.passed(edges, begin, end)
        host.heard.clear()


@pytest.mark.slow
def test_ten_minutes_of_commands_loss_garbage_and_rearming_break_no_invariant(new_host):
    rng = np.random.default_rng(11)
    host = new_host(board={"clock_us": (1 << 32) - MINUTE})
    opened, did = 0, Counter()
    for cause in list(ResetCause)[1:]:  # five boots, two minutes each
        host.board.power_cycle(cause)
        host.decoder.feed(b"\0")
        host.listen()
        host.board.sense(24_000, 500_000)
        assert host.hello().state == State.SAFE
        seen = Observer(host.limits)
        soak(host, seen, rng, 2 * MINUTE)
        for valve in range(8):
            assert seen.most_open_us(valve) <= host.limits.duty_budget_us
        opened += sum(map(len, seen.openings))
        status = host.status
        did.update({name: getattr(status, name) for name in COUNTERS})
        assert (status.lost_edges, status.lost_acks) == (0, 0)
    # it did something, and every limit was met
    assert opened > 4_000
    assert all(did[name] > 10 for name in COUNTERS), did
