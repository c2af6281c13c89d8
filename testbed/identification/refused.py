"""A log that is refused, and columns that refuse what they do not have."""

import numpy as np
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.spelling import did_you_mean

Array = NDArray[np.float64]
MOST = 60  # names of columns in a message
SHORT = 3  # names of so many characters are alike by chance: y_m does not mean x_m


class LogRefusedError(TestbedError):
    """The log cannot be used; the message names the suspected reason."""


class NumericColumns(dict[str, Array]):
    """Numeric columns of equal length; a missing one is refused with its name."""

    def __init__(self, where: str, columns: dict[str, Array]) -> None:
        super().__init__(columns)
        self.where = where

    def __missing__(self, name: str) -> Array:
        hint = did_you_mean(name, list(self)) if len(name) > SHORT else ""
        raise LogRefusedError(
            where=self.where,
            expected=f"a column {name!r}, named by the mapping or an option",
            found=f"no such column{hint}",
            hint=f"the columns are: {', '.join(list(self)[:MOST])}" + " ..." * (len(self) > MOST),
        )

    def whole(self, name: str) -> Array:
        """A column; a missing value is refused."""
        values = self[name]
        if (bad := int(np.sum(~np.isfinite(values)))) > 0:
            row = int(np.argmin(np.isfinite(values))) + 1
            raise LogRefusedError(
                where=self.where,
                expected=f"a number in every row of {name!r}",
                found=f"{bad} rows without one, the first is data row {row}",
            )
        return values
