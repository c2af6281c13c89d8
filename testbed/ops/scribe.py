"""The recorder's own process: frames from a pipe into an MCAP file, until the pipe ends.

    python -m testbed.ops.scribe LOG

It is started by `recorder.py` and outlives whatever happens to the flight by the time it takes to
finish the file.
"""

import sys
from pathlib import Path
from typing import BinaryIO

import msgspec
from mcap.writer import CompressionType, Writer

from testbed.ops.recorder import Entry, Frame, Topic

CHUNK = 256 * 1024  # [bytes] at most this much is lost when the machine dies


def write_log(path: Path, pipe: BinaryIO) -> None:
    """Copy frames into a new file at `path`."""
    decode = msgspec.msgpack.Decoder(Frame).decode
    channels: list[int] = []
    with path.open("xb") as file:  # never over an older log
        writer = Writer(file, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        writer.start(profile="", library="airbearing-testbed")
        sequence = 0
        while len(head := pipe.read(4)) == 4:
            size = int.from_bytes(head, "little")
            if len(body := pipe.read(size)) < size:
                break  # the flight was killed in the middle of a frame
            match decode(body):
                case Topic(name, schema_name, schema):
                    number = writer.register_schema(schema_name, "jsonschema", schema)
                    channels.append(writer.register_channel(name, "json", number))
                case Entry(topic, stamp, data):
                    sequence += 1
                    writer.add_message(channels[topic], stamp, data, stamp, sequence)
        writer.finish()


def main() -> int:
    """Write until the pipe ends; 1 and a line on stderr if that is impossible."""
    try:
        write_log(Path(sys.argv[1]), sys.stdin.buffer)
    except OSError as error:
        sys.stderr.write(f"{error.filename or sys.argv[1]}: {error.strerror}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
