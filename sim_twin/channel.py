"""A wireless link without the wires: delay, jitter, and loss that comes in bursts.

Gilbert-Elliott: the channel is good or bad, changes state with a probability per message, and loses
messages with a probability that depends on the state. Jitter has an exponential tail, so messages
can overtake each other; the receiver keeps the one that was sent last.
"""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import numpy as np

from sim_twin.randomness import rows
from testbed.core.table import Link

M = TypeVar("M")


class Channel(Generic[M]):
    """One direction between two parties; newest message wins."""

    def __init__(self, link: Link, rng: np.random.Generator) -> None:
        self._link = link
        # a fixed number of draws per message: what is lost does not depend on what is injected
        luck, delays = rng.spawn(2)
        self._chance = zip(rows(luck.random, 3), rows(delays.standard_exponential, 1), strict=True)
        self._bad = False
        self._sent = 0
        self._number = 0  # of the message heard last
        self._message: M | None = None
        self._on_the_way: list[tuple[float, int, M]] = []  # (arrival, number, message)

    def send(self, t: float, message: M, trouble: tuple[float, float] = (0.0, 0.0)) -> None:
        """Put a message on the air at time `t` [s].

        `trouble` is an injected delay [s] and probability of loss on top of the link's own.
        """
        link = self._link
        (turn, lose, unlucky), (delay,) = next(self._chance)
        if turn < (link.burst_leave if self._bad else link.burst_enter):
            self._bad = not self._bad
        self._sent += 1
        if lose < (link.burst_loss if self._bad else link.loss):
            return
        if unlucky < trouble[1]:
            return
        arrival = t + trouble[0] + link.delay_s + link.jitter_s * delay
        self._on_the_way.append((arrival, self._sent, message))

    def newest(self, t: float) -> M | None:
        """The message sent last of all that have arrived by `t`, however old; None before any."""
        for entry in self._on_the_way:
            if entry[0] <= t:
                self._listen(t)
                break
        return self._message

    def _listen(self, t: float) -> None:
        waiting = []
        for entry in self._on_the_way:
            arrival, number, message = entry
            if arrival > t:
                waiting.append(entry)
            elif number > self._number:
                self._number, self._message = number, message
        self._on_the_way = waiting

    def forget(self) -> None:
        """They have lost each other: what was said is worth nothing when they meet again."""
        self._on_the_way, self._number, self._message = [], self._sent, None


class RadioMedium(Generic[M]):
    """The channels of one kind of message between many, each made when it is first used."""

    def __init__(self, make: Callable[[str, str], Channel[M]]) -> None:
        """`make` gives the channel from a sender to a receiver."""
        self._make, self._channels = make, dict[tuple[str, str], Channel[M]]()

    def between(self, sender: str, receiver: str) -> Channel[M]:
        """From one to the other."""
        channel = self._channels.get((sender, receiver))
        if channel is None:
            channel = self._channels[sender, receiver] = self._make(sender, receiver)
        return channel

    def part(self, sender: str, receiver: str) -> None:
        """They have moved out of range."""
        if (sender, receiver) in self._channels:
            self._channels[sender, receiver].forget()

    def heard(self, receiver: str, senders: Iterable[str], t: float) -> dict[str, M]:
        """The newest of each of `senders` that `receiver` has heard by `t`."""
        found: dict[str, M] = {}
        if not self._channels:  # nobody has anything of the kind to say
            return found
        for sender in senders:
            channel = self._channels.get((sender, receiver))
            if channel is not None and (message := channel.newest(t)) is not None:
                found[sender] = message
        return found
