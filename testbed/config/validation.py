"""Finds where a tree does not match a struct, with messages in terms of the TOML file.

msgspec decides whether it matches, but its message does not name the entry of a table. So the tree
and the types are walked again to find the first mismatch.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
from msgspec import Struct, inspect

from testbed.config.error import Violation, did_you_mean, refused, show
from testbed.config.key import Key, spell
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle

MISSING = "nothing: the key is missing"
INCLUDED = (Table, Vehicle)  # may be separate files


def first_violation(tree: Any, struct: type[Struct]) -> Violation:
    """The first mismatch of a tree that msgspec could not convert to `struct`."""
    kind = inspect.type_info(struct)
    return _violation((), tree, kind) or Violation((), describe(kind), show(tree))


def describe(kind: inspect.Type) -> str:
    """A type in words, for a person who edits TOML."""
    match kind:
        case inspect.FloatType():
            return "a number" + _bounds(kind)
        case inspect.IntType():
            return "a whole number" + _bounds(kind)
        case inspect.StrType():
            return "a string"
        case inspect.BoolType():
            return "true or false"
        case inspect.LiteralType(values=values):
            return f"one of: {', '.join(map(str, values))}"
        case inspect.TupleType(item_types=items):
            return f"a list of {len(items)}, each {describe(items[0])}"
        case inspect.ListType(item_type=item) | inspect.VarTupleType(item_type=item):
            return f"a list{_lengths(kind)}, each entry {describe(item)}"
        case inspect.StructType(cls=cls):
            return "a table" + " or the path of a TOML file" * (cls in INCLUDED)
        case inspect.DictType():
            return "a table"
        case inspect.AnyType():
            return "a value"
        case inspect.UnionType(types=types):
            if tagged := _tagged(kind):
                return f"a table whose `type` is one of: {', '.join(tagged)}"
            return " or ".join(describe(t) for t in types if not isinstance(t, inspect.NoneType))
    return str(kind)


def _bounds(kind: inspect.FloatType | inspect.IntType) -> str:
    number = "{:g}" if isinstance(kind, inspect.FloatType) else "{}"
    signs = ((">", kind.gt), (">=", kind.ge), ("<", kind.lt), ("<=", kind.le))
    bounds = [f"{sign} {number.format(bound)}" for sign, bound in signs if bound is not None]
    return f" {' and '.join(bounds)}".rstrip()


def _lengths(kind: inspect.ListType | inspect.VarTupleType) -> str:
    least, most = kind.min_length, kind.max_length
    if least is None and most is None:
        return ""
    return f" of {least or 0}{' or more' if most is None else f' to {most}'}"


def _tagged(kind: inspect.UnionType) -> dict[str, inspect.StructType]:
    """The structs among which a table's `type` selects."""
    structs = (t for t in kind.types if isinstance(t, inspect.StructType))
    return {str(t.tag): t for t in structs if t.tag_field == "type"}


def _violation(key: Key, value: Any, kind: inspect.Type) -> Violation | None:
    """The first mismatch of `value` at `key`."""
    match kind, value:
        case inspect.StructType(), dict():
            return _struct_violation(key, value, kind)
        case inspect.UnionType(), _:
            return _union_violation(key, value, kind)
        case inspect.DictType(value_type=entry), dict():
            entries = [((*key, name), item, entry) for name, item in value.items()]
        case ((inspect.ListType(item_type=entry) | inspect.VarTupleType(item_type=entry)), list()):
            if not (kind.min_length or 0) <= len(value) <= (kind.max_length or len(value)):
                return Violation(key, describe(kind), f"{len(value)} entries")
            entries = [((*key, i), item, entry) for i, item in enumerate(value)]
        case inspect.TupleType(item_types=types), list() if len(types) == len(value):
            pairs = enumerate(zip(value, types, strict=True))
            entries = [((*key, i), item, entry) for i, (item, entry) in pairs]
        case _:
            return None if _fits(value, kind) else _misfit(key, value, kind)
    return _first(entries)


def _misfit(key: Key, value: Any, kind: inspect.Type) -> Violation:
    """The mismatch of a value without entries."""
    hint = ""
    if isinstance(kind, inspect.LiteralType) and isinstance(value, str):
        hint = did_you_mean(value, [one for one in kind.values if isinstance(one, str)])
    return Violation(key, describe(kind), show(value) + hint)


def _first(entries: Sequence[tuple[Key, Any, inspect.Type]]) -> Violation | None:
    return next((violation for entry in entries if (violation := _violation(*entry))), None)


def _fits(value: Any, kind: inspect.Type) -> bool:
    """Whether a value without entries is of this type."""
    match kind:
        case inspect.FloatType() | inspect.IntType():
            whole = isinstance(kind, inspect.IntType)
            if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
                return False
            return (
                (kind.gt is None or value > kind.gt)
                and (kind.ge is None or value >= kind.ge)
                and (kind.lt is None or value < kind.lt)
                and (kind.le is None or value <= kind.le)
            )
        case inspect.StrType():
            return isinstance(value, str)
        case inspect.BoolType():
            return isinstance(value, bool)
        case inspect.LiteralType(values=values):
            return value in values
        case inspect.AnyType():
            return True
    return False


def _struct_violation(
    key: Key, table: dict[str, Any], kind: inspect.StructType
) -> Violation | None:
    fields = {field.encode_name: field for field in kind.fields}
    known = sorted([*fields, *filter(None, [kind.tag_field])])
    for name in table:
        if name not in known:
            found = f"unknown key `{spell((name,))}`{did_you_mean(name, known)}"
            return Violation((*key, name), f"one of: {', '.join(known)}", found)
    for name, field in fields.items():
        if name in table:
            if violation := _violation((*key, name), table[name], field.type):
                return violation
        elif field.required:
            others = [one for one in _missing(table, kind) if one != name]
            found = MISSING + (f"; missing as well: {', '.join(others)}" if others else "")
            return Violation((*key, name), describe(field.type), found)
    return _refusal(key, table, kind.cls)


def _missing(table: dict[str, Any], kind: inspect.StructType) -> Iterator[str]:
    """Names of all required keys that a table and the tables in it do not have."""
    for field in kind.fields:
        name, value = field.encode_name, table.get(field.encode_name)
        if value is None and field.required:
            yield name
        elif isinstance(value, dict) and isinstance(field.type, inspect.StructType):
            yield from (f"{name}.{one}" for one in _missing(value, field.type))


def _refusal(key: Key, table: dict[str, Any], cls: type) -> Violation | None:
    """The error of the struct's own check on values that are valid one by one."""
    try:
        msgspec.convert(table, cls)
    except msgspec.ValidationError as error:
        return refused(key, error)
    return None


def _union_violation(key: Key, value: Any, kind: inspect.UnionType) -> Violation | None:
    tagged = _tagged(kind)
    if tagged and isinstance(value, dict):
        return _tagged_violation(key, value, tagged)
    violations = [_violation(key, value, t) for t in kind.types]
    if None in violations:
        return None
    inside = (violation for violation in violations if violation and violation.key != key)
    return next(inside, Violation(key, describe(kind), show(value)))


def _tagged_violation(
    key: Key, table: dict[str, Any], options: dict[str, inspect.StructType]
) -> Violation | None:
    """The mismatch of a table whose `type` selects the struct."""
    found = MISSING
    if "type" in table:
        tag = table["type"]
        if isinstance(tag, str) and tag in options:
            return _struct_violation(key, table, options[tag])
        found = show(tag) + (did_you_mean(tag, options) if isinstance(tag, str) else "")
    return Violation((*key, "type"), f"one of: {', '.join(options)}", found)
