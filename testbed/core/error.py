"""Base class of all errors that this software raises on purpose."""


class TestbedError(Exception):
    """An error the caller can act on: where, what was expected, what was found, what to do.

    Args:
        text: a plain sentence, if the four parts below do not apply.
        where: the file, key, device or vehicle concerned.
        expected: a valid value.
        found: the actual value.
        hint: what to do.
    """

    __test__ = False  # pytest must not collect it because of its name

    def __init__(
        self, text: str = "", *, where: str = "", expected: str = "", found: str = "",
        hint: str = "",
    ) -> None:  # fmt: skip
        self.where, self.expected, self.found, self.hint = where, expected, found, hint
        parts = (("expected", expected), ("found", found), ("hint", hint))
        lines = [f"  {name:<8}  {part}" for name, part in parts if part]
        super().__init__("\n".join([text or where, *lines]))


class MismatchError(TestbedError, ValueError):
    """A value that its struct or law refuses.

    Args:
        expected: a valid value.
        found: the actual value.
        about: which part of the struct it is.
    """

    def __init__(self, expected: str, found: str, about: str = "") -> None:
        super().__init__(expected=expected, found=found)
        self.args = (expected, found, about)

    def __str__(self) -> str:
        expected, found, about = self.args
        return f"{about}{': ' * bool(about)}expected {expected}, found {found}"
