"""Columns of numbers with their units."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.extra import needs_extra

Array = NDArray[Any]
SHOWN_ROWS = 10


class UnknownNameError(TestbedError, KeyError):
    """A table has no column of this name, or a run no vehicle."""

    __str__ = Exception.__str__  # KeyError would show the text in quotes


class Table(Mapping[str, Array]):
    """Named columns of equal length. A table equals itself only.

    Args:
        columns: one array of shape (n,) per name.
        units: units by column, as in "m/s".
    """

    def __init__(
        self, columns: Mapping[str, Array], units: Mapping[str, str] | None = None
    ) -> None:
        self._columns = {name: np.asarray(column) for name, column in columns.items()}
        self.units = dict(units or {})

    def __getitem__(self, name: str) -> Array:
        """A column as an array.

        Raises:
            KeyError: the table has no column of this name; a `TestbedError` too.
        """
        named = isinstance(name, str)
        if not named or name not in self._columns:
            raise UnknownNameError(
                where="table", expected=f"one of {', '.join(self)}", found=repr(name),
                hint="" if named else "index the columns: table['t'][0]",
            )  # fmt: skip
        return self._columns[name]

    __eq__, __hash__ = object.__eq__, object.__hash__  # a mapping's would compare arrays

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return max(map(len, self._columns.values()), default=0)

    def to_pandas(self) -> Any:
        """The same as a pandas DataFrame; the units are in `.attrs["units"]`."""
        with needs_extra("notebook"):
            import pandas as pd

        frame = pd.DataFrame({name: list(c) if c.ndim > 1 else c for name, c in self.items()})
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_arrow(self) -> Any:
        """The same as a pyarrow Table; the units are in the metadata of the fields."""
        with needs_extra("export"):
            import pyarrow as pa

        fields = [
            pa.field(name, pa.array(column).type, metadata={"unit": self.units.get(name, "")})
            for name, column in self.items()
        ]
        return pa.table([pa.array(column) for column in self.values()], schema=pa.schema(fields))

    def _heads(self) -> list[str]:
        return [f"{n} [{self.units[n]}]" if self.units.get(n) else n for n in self]

    def __repr__(self) -> str:
        return f"Table of {self.rows} rows: {', '.join(self._heads())}"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(name)}</th>" for name in self._heads())
        body = "".join(
            "<tr>" + "".join(f"<td>{_cell(c[k])}</td>" for c in self.values()) + "</tr>"
            for k in range(min(self.rows, SHOWN_ROWS))
        )
        more = f"<p>{self.rows} rows</p>" if self.rows > SHOWN_ROWS else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float | np.floating) else escape(str(value))
