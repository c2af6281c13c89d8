"""`testbed calibrate link`: delay, jitter and loss of a radio link from sent and received times."""

import numpy as np

from testbed.identification.columns import LogRefusedError, NumericColumns

LONGEST = 2.0  # [s] delay of a link
BURSTS = 2.0  # a loss is this many times likelier after a loss: losses come in bursts


def link_of(columns: NumericColumns, sent: str, received: str) -> dict[str, float]:
    """Numbers of `[link]` in a table file.

    Args:
        columns: one row per message, in the order of sending.
        sent: column of the sending time [s].
        received: column of the arrival on the same clock, empty where it was lost [s].

    Raises:
        LogRefusedError: there are too few messages, or they arrive before they are sent.
    """
    start, end = columns.whole(sent), columns[received]
    came = np.isfinite(end)
    if came.sum() < 50:
        raise LogRefusedError(
            where=columns.where, expected="50 messages that arrived", found=f"{came.sum()}"
        )
    delay = end[came] - start[came]
    if delay.min() < 0.0:
        raise LogRefusedError(
            where=columns.where, expected="arrival after sending",
            found=f"{delay.min():.4g} s",
            hint="the stamps are of two clocks: subtract their offset first;"
            " or a lost message has a number: leave its arrival empty",
        )  # fmt: skip
    usual = float(np.median(delay))
    if usual > LONGEST:
        raise LogRefusedError(
            where=columns.where, expected=f"delays of up to {LONGEST:g} s", found=f"{usual:.4g} s",
            hint="times are in s; 1000 times off means ms, or the stamps are of two clocks",
        )  # fmt: skip
    least = float(np.quantile(delay, 0.01))
    lost = ~came
    share = float(lost.mean())
    again = float(lost[1:][lost[:-1]].mean()) if lost[:-1].any() else 0.0
    bursts = again > BURSTS * max(share, 1.0 / len(lost)) and lost.sum() > 10
    leave = max(1.0 - again, 0.01)
    return {
        "delay_s": least,
        "jitter_s": float(np.mean(delay) - least),
        "loss": 0.0 if bursts else share,
        "burst_loss": 1.0 if bursts else 0.0,
        "burst_enter": share * leave / (1.0 - share) if bursts else 0.0,
        "burst_leave": leave if bursts else 1.0,
    }
