"""The process of a vendor's motion-capture package, which may hang or die; see `foreign.py`.

    python foreign_process.py SYSTEM SETTINGS_AS_JSON

Each message on standard output is a length and (number, monotonic time [ns], bodies). The process
ends when its standard input closes.
"""

import os
import struct
import sys
import threading
import time

import msgspec


def end_with_parent() -> None:
    """Wait until the parent closes standard input or dies."""
    sys.stdin.buffer.read()
    os._exit(0)


def main() -> None:
    """Send every frame of the package."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    out = os.dup(1)
    os.dup2(2, 1)  # keep the package's output out of the pipe
    import motioncapture

    system = motioncapture.connect(sys.argv[1], msgspec.json.decode(sys.argv[2]))
    number = 0
    while True:
        system.waitForNextFrame()
        now, bodies = time.monotonic_ns(), {}
        for name, body in system.rigidBodies.items():
            p, q = body.position, body.rotation
            bodies[name] = (float(p[0]), float(p[1]), float(p[2]), q.x, q.y, q.z, q.w)
        number += 1
        data = msgspec.msgpack.encode((number, now, bodies))
        os.write(out, struct.pack("<I", len(data)) + data)


if __name__ == "__main__":
    main()
