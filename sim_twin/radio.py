"""A model of wireless links: delay, jitter and burst loss.

Loss follows the Gilbert-Elliott model: the channel is good or bad, changes state with a probability
per message, and loses messages with a probability that depends on the state. Jitter has an
exponential tail, so messages can overtake each other; the receiver keeps the last one sent.

A message is a row of numbers. Each link has room for its newest one and for those on the way.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.randomness import WORDS, Words, exponential, stream, uniform, words
from testbed.core.compiled import borrowed, compiled, with_fixed_types
from testbed.core.table import Link

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

DELAY, JITTER, LOSS, BURST_LOSS, BURST_ENTER, BURST_LEAVE = range(6)  # columns of `Links.model`
SENT, NEWEST, SIZE, WAITING = range(4)  # columns of `Links.tally`
ROOM = 8  # messages on the way on one link, at first
SILENCE = -1  # size of the newest message before the first


class Links(NamedTuple):
    """All links, from one sender to one receiver, for compiled code; a row each."""

    model: Array  # (n, 6) see table.Link
    injected: Array  # (n, 2) injected delay [s] and loss probability, added to the link's own
    losses: Words  # (n, WORDS) stream of the losses
    delays: Words  # (n, WORDS) stream of the jitter
    bad: NDArray[np.bool_]  # (n,) state of the channel
    # (n, 4) number of messages sent; place among them, and size, of the newest that arrived;
    # how many are on the way
    tally: Whole
    newest: Array  # (n, width) the newest message that arrived
    arrival: Array  # (n, room) of those on the way [s]
    on_the_way: Whole  # (n, room, 2) place among those sent, size
    waiting: Array  # (n, room, width) the messages on the way


def no_links(rows: int, room: int, width: int) -> Links:
    """Links that nothing has been sent on."""
    return Links(
        np.zeros((rows, 6)),
        np.zeros((rows, 2)),
        np.zeros((rows, WORDS), np.uint64),
        np.zeros((rows, WORDS), np.uint64),
        np.zeros(rows, np.bool_),
        np.tile(np.array([0, 0, SILENCE, 0]), (rows, 1)),
        np.zeros((rows, width)),
        np.zeros((rows, room)),
        np.zeros((rows, room, 2), np.int64),
        np.zeros((rows, room, width)),
    )


@compiled
def send(links, rows, t, message):
    """Send a message on the links `rows` at time `t` [s]; there is room for its numbers.

    Returns:
        whether any link has no room for another message.
    """
    links, full, size = borrowed(links), False, message.shape[0]
    for k in rows:
        count, model = links.tally[k], links.model[k]
        # a fixed number of draws per message: losses do not depend on injected faults
        turn, lose = uniform(links.losses[k]), uniform(links.losses[k])
        lose_too, delay = uniform(links.losses[k]), exponential(links.delays[k])
        if turn < model[BURST_LEAVE if links.bad[k] else BURST_ENTER]:
            links.bad[k] = not links.bad[k]
        count[SENT] += 1
        if lose < model[BURST_LOSS if links.bad[k] else LOSS] or lose_too < links.injected[k, 1]:
            continue
        arrival = t + links.injected[k, 0] + model[DELAY] + model[JITTER] * delay
        if arrival <= t:
            count[NEWEST], count[SIZE] = count[SENT], size
            links.newest[k, :size] = message
            continue
        i = count[WAITING]
        links.arrival[k, i] = arrival
        links.on_the_way[k, i, 0], links.on_the_way[k, i, 1] = count[SENT], size
        links.waiting[k, i, :size] = message
        count[WAITING] = i + 1
        full = full or i + 1 == links.arrival.shape[1]
    return full


@compiled
def listen(links, t):
    """Receive what has arrived by time `t` [s]."""
    links = borrowed(links)
    for k in range(links.tally.shape[0]):
        count, left = links.tally[k], 0
        for i in range(count[WAITING]):
            place, size = links.on_the_way[k, i, 0], links.on_the_way[k, i, 1]
            if links.arrival[k, i] > t:
                if left < i:
                    links.arrival[k, left] = links.arrival[k, i]
                    links.on_the_way[k, left, 0], links.on_the_way[k, left, 1] = place, size
                    links.waiting[k, left, :size] = links.waiting[k, i, :size]
                left += 1
            elif place > count[NEWEST]:
                count[NEWEST], count[SIZE] = place, size
                links.newest[k, :size] = links.waiting[k, i, :size]
        count[WAITING] = left


class Radio:
    """All links for one kind of message, each created on first use."""

    def __init__(self, link: Link, seed: int) -> None:
        self._seed = seed
        self._model = (
            link.delay_s, link.jitter_s, link.loss, link.burst_loss, link.burst_enter,
            link.burst_leave,
        )  # fmt: skip
        self.links = no_links(0, ROOM, 1)
        self._rows: dict[tuple[str, str], int] = {}
        self._injected: dict[str, tuple[float, float]] = {}
        self._send = with_fixed_types(send)

    def rows(self, pairs: Iterable[tuple[str, str]]) -> Whole:
        """The rows of the links from each sender to its receiver."""
        return np.array([self._row(*pair) for pair in pairs], np.int64)

    def _row(self, sender: str, receiver: str) -> int:
        row = self._rows.get((sender, receiver))
        if row is None:
            row = self._rows[sender, receiver] = len(self._rows)
            if row == len(self.links.bad):
                self._grow(rows=2 * row + 16)
            self._seed_link(row, sender, receiver)
            self.links.model[row] = self._model
            self.links.injected[row] = self._injected.get(receiver, 0.0)
        return row

    def _seed_link(self, row: int, sender: str, receiver: str) -> None:
        losses, delays = stream(self._seed, "link", sender, "to", receiver).spawn(2)
        self.links.losses[row], self.links.delays[row] = words(losses), words(delays)

    def reseed(self, seed: int) -> None:
        """Draw other random numbers from now on."""
        self._seed = seed
        for pair, row in self._rows.items():
            self._seed_link(row, *pair)

    def _grow(self, *, rows: int = 0, room: int = 0, width: int = 0) -> None:
        old, (had, has_room, had_width) = self.links, self.links.waiting.shape
        self.links = no_links(max(rows, had), max(room, has_room), max(width, had_width))
        for new, before in zip(self.links, old, strict=True):
            new[tuple(slice(n) for n in before.shape)] = before

    def make_room(self) -> None:
        """Make room for more messages on the way."""
        self._grow(room=2 * self.links.arrival.shape[1])

    def widen(self, size: int) -> None:
        """Make room for messages of so many numbers."""
        if size > self.links.newest.shape[1]:
            self._grow(width=size)

    def disturb(self, receiver: str, late: float, lost: float) -> None:
        """Let messages to `receiver` take longer [s] and be lost with a further probability."""
        if self._injected.get(receiver, (0.0, 0.0)) != (late, lost):
            self._injected[receiver] = late, lost
            for (_, to), row in self._rows.items():
                if to == receiver:
                    self.links.injected[row] = late, lost

    def send(self, rows: Whole, t: float, message: Array) -> None:
        """Send a message on these links at time `t` [s]; `listen` was called for it."""
        self.widen(len(message))
        if self._send(self.links, rows, t, message):
            self.make_room()

    def received(self, receiver: str, senders: Iterable[str]) -> dict[str, Array]:
        """The newest message of each of `senders`, of any age."""
        found = {sender: self.newest(sender, receiver) for sender in senders}
        return {sender: one for sender, one in found.items() if one is not None}

    def newest(self, sender: str, receiver: str) -> Array | None:
        """The newest message that arrived, of any age; None if there is none."""
        row = self._rows.get((sender, receiver))
        if row is None or (size := int(self.links.tally[row, SIZE])) == SILENCE:
            return None
        return self.links.newest[row, :size].copy()

    def drop_link(self, sender: str, receiver: str) -> None:
        """Drop all messages of a link, because the vehicles moved out of range."""
        row = self._rows.get((sender, receiver))
        if row is not None:
            self.links.tally[row, NEWEST:] = self.links.tally[row, SENT], SILENCE, 0
