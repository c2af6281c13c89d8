"""Types of the nodes in an ONNX file, read from its protobuf: onnxruntime does not tell them.

A protobuf message is a list of fields: a tag, which is the field's number and kind, and the value.
Nodes are in the model's graph, in its functions, and in the graphs that are attributes of nodes.
"""

from collections.abc import Iterator

INSIDE = {  # by message: numbers of the fields that lead to nodes, and the messages in them
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {6: "graph", 11: "graph"},
}
INPUT, OP_TYPE = 1, 4  # fields of a node: names of inputs, one after the other; the type
TRAINED = "Dropout in training mode"  # a third input says so; without it Dropout does nothing
VARINT, EIGHT_BYTES, BYTES, FOUR_BYTES = 0, 1, 2, 5  # kinds of fields


def node_types(content: bytes) -> set[str]:
    """Types of all nodes of a model, such as "MatMul", also of those in subgraphs; and TRAINED.

    Raises:
        ValueError: the content is no protobuf.
    """
    found, todo = set(), [("model", memoryview(content))]
    while todo:
        message, data = todo.pop()
        inputs, kind = list[bytes](), ""
        for number, value in _fields(data):
            if number in INSIDE[message]:
                todo.append((INSIDE[message][number], value))
            elif message == "node" and number == OP_TYPE:
                kind = bytes(value).decode()
            elif message == "node" and number == INPUT:
                inputs.append(bytes(value))
        if kind:
            found.add(TRAINED if kind == "Dropout" and any(inputs[2:]) else kind)
    return found


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Number and value of the fields that hold bytes; those that hold numbers are left out."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        number, kind = tag >> 3, tag & 7
        if kind == VARINT:
            _, at = _varint(data, at)
        elif kind == BYTES:
            size, at = _varint(data, at)
            yield number, data[at : at + size]
            at += size
        elif kind in (EIGHT_BYTES, FOUR_BYTES):
            at += 8 if kind == EIGHT_BYTES else 4
        else:
            raise ValueError(f"no field of a protobuf message: tag {tag}")


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """The number that begins at `at`, seven bits a byte, lowest first; and where it ends."""
    value, shift = 0, 0
    while at < len(data):
        value |= (data[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if data[at - 1] < 0x80:
            return value, at
    raise ValueError("the protobuf message ends early")
