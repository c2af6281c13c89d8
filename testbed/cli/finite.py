"""Numbers of the command line that must be finite; click's ranges let nan and inf through."""

import math

import click


def finite(context: click.Context, option: click.Parameter, value: float | None) -> float | None:
    """Refuse an option's value that is not finite; the callback of such an option.

    Raises:
        click.BadParameter: it is not.
    """
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number.", context, option)
    return value
