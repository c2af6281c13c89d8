"""The force nearest to a demand within a disc and half-planes, exactly."""

import numpy as np

from testbed.core.compiled import compiled

TIGHT = 1e-9  # rounding tolerance of a half-plane [N]
HALVINGS = 40


@compiled
def feasible(x, y, planes, count, radius, slack):
    """Whether a force is within the disc and all half-planes, each `slack` wider."""
    if x * x + y * y > radius * radius * (1.0 + 1e-9):
        return False
    for i in range(count):
        if planes[i, 0] * x + planes[i, 1] * y > planes[i, 2] + slack + TIGHT:
            return False
    return True


@compiled
def nearest(fx, fy, planes, count, radius, slack):
    """The feasible force nearest to (fx, fy): found or not, x, y.

    Args:
        fx: demand [N].
        fy: [N].
        planes: rows (gx, gy, h): gx x + gy y <= h, (gx, gy) of length 1; shape (n, >= 3).
        count: rows in use.
        radius: of the disc [N].
        slack: by which every half-plane is widened [N].
    """
    if feasible(fx, fy, planes, count, radius, slack):
        return True, fx, fy
    best, bx, by = np.inf, 0.0, 0.0
    size = np.sqrt(fx * fx + fy * fy)
    if size > radius:  # the rim of the disc alone
        x, y = fx * radius / size, fy * radius / size
        if feasible(x, y, planes, count, radius, slack):
            best, bx, by = (size - radius) * (size - radius), x, y
    for i in range(count):
        gx, gy, h = planes[i, 0], planes[i, 1], planes[i, 2] + slack
        off = gx * fx + gy * fy - h
        x, y = fx - off * gx, fy - off * gy
        if off > 0.0 and off * off < best and feasible(x, y, planes, count, radius, slack):
            best, bx, by = off * off, x, y
        if abs(h) <= radius:  # where the line meets the rim
            along = np.sqrt(radius * radius - h * h)
            for side in (-1.0, 1.0):
                x, y = h * gx - side * along * gy, h * gy + side * along * gx
                far = (x - fx) * (x - fx) + (y - fy) * (y - fy)
                if far < best and feasible(x, y, planes, count, radius, slack):
                    best, bx, by = far, x, y
        for j in range(i):
            det = gx * planes[j, 1] - gy * planes[j, 0]
            if abs(det) < 1e-9:
                continue
            k = planes[j, 2] + slack
            x, y = (h * planes[j, 1] - k * gy) / det, (gx * k - planes[j, 0] * h) / det
            far = (x - fx) * (x - fx) + (y - fy) * (y - fy)
            if far < best and feasible(x, y, planes, count, radius, slack):
                best, bx, by = far, x, y
    return best < np.inf, bx, by


@compiled
def yielding(fx, fy, planes, count, radius):
    """`nearest`, with the half-planes widened by the least amount that makes it feasible."""
    found, x, y = nearest(fx, fy, planes, count, radius, 0.0)
    if found:
        return x, y
    low, high = 0.0, 1.0
    while not nearest(fx, fy, planes, count, radius, high)[0]:
        low, high = high, 2.0 * high
        if high > 1e9:
            return 0.0, 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if nearest(fx, fy, planes, count, radius, middle)[0]:
            high = middle
        else:
            low = middle
    _, x, y = nearest(fx, fy, planes, count, radius, high)
    return x, y
