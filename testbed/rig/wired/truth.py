"""True poses that the twin's server sends to the host."""

import math

import msgspec

_decode = msgspec.msgpack.Decoder(tuple[int, dict[str, list[float]]]).decode


def newest_truth(messages: list[tuple[int, bytes]]) -> dict[str, list[float]] | None:
    """Poses and velocities of the newest valid message, by vehicle; None: there is none."""
    for _, data in reversed(messages):
        try:
            states = _decode(data)[1]
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            continue
        if all(len(row) == 6 and all(map(math.isfinite, row)) for row in states.values()):
            return states
    return None
