"""Latency from a pose frame to the valve command on the serial line, beside bare UDP and pty.

    python benchmarks/pose_to_valve.py [--seconds 20] [--vehicles 3] [--rate 100] [--no-chain]

One process per vehicle: NatNet in, estimator, tracker, allocation, modulation, gate, and a plan out
as a frame on a pty behind which real firmware runs. Beside each a bare one: a datagram in, as many
bytes out on a pty. They take turns, second by second, in one run; latency is from just before the
datagram is sent to the first byte read at the far end of the pty. SCHED_FIFO where allowed. The
first frames of a turn do not count: the board has tripped meanwhile, and is armed again.

With `--no-chain` a vehicle flies its chain for 50 frames only, and then sends those plans again:
what is left is what Python takes to read a frame and to send a plan.
"""

import argparse
import os
import pty
import select
import socket
import subprocess
import sys
import tempfile
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np

from firmware_interface.frame import Decoder
from firmware_interface.limits import limits_of
from firmware_interface.line_tap import LineTap
from firmware_interface.messages import Cmd
from testbed.config import find, load
from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.exposure import Axes
from testbed.mocap.natnet import Described, MocapFrame, RigidBody, encode_frame
from testbed.mocap.natnet_server import NatNetAddress, NatNetServer
from testbed.realtime.scheduling import realtime_priority, steady_memory
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.wired.local import free_port

WORDS = [
    "flight.jet_period_s=0.01", "vehicles.*.model.command_delay_s=0.0", "duration_s=10",
    "flight.gate.max_speed=100.0", "flight.gate.max_spin=100.0", "flight.gate.max_rejected=1000000",
]  # fmt: skip
SETTLE = 5  # frames at the beginning of a turn
BARE = """
import os, socket, sys
from testbed.realtime.scheduling import realtime_priority
one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
one.bind(("127.0.0.1", int(sys.argv[1])))
line = os.open(sys.argv[2], os.O_RDWR | os.O_NOCTTY)
answer = bytes(94)
print("ready", flush=True)
with realtime_priority(20):
    while one.recv(65536) != b"end":
        os.write(line, answer)
"""
CHAIN = """
import select, sys
from msgspec.structs import replace
from firmware_interface.limits import limits_of
from firmware_interface.serial_thrusters import SerialThrusters
from testbed.config import find, load
from testbed.core.lab import MocapWire
from testbed.core.types import Accel, Inputs, Pose, Reference, Trajectory, Twist
from testbed.mocap.natnet_client import NatNetClient
from testbed.mocap.poses import MocapPoses
from testbed.realtime.scheduling import realtime_priority, steady_memory
from testbed.realtime.wall_clock import WallClock, monotonic_ns
from testbed.rig.chain import make_agent
from testbed.rig.twin import warm_up
name, port, command, flown, *words = sys.argv[1:]
experiment = load(find("zhang2023_table"), words)
warm_up(experiment)
setup = experiment.vehicles[name]
agent = make_agent(experiment, name)
client = NatNetClient(MocapWire(command_port=int(command)))
clock = WallClock(monotonic_ns())
poses = MocapPoses(client, MocapWire(), clock, name)
goal = Reference(0.0, Pose(*setup.start), Twist(0, 0, 0), Accel(0, 0, 0))
setpoint = Trajectory((goal,), 1e9)
with steady_memory(), SerialThrusters(port, limits_of(setup.model), 0.0, 7) as thrusters:
    thrusters.epoch_us = clock.epoch_ns // 1000
    heard = 0
    while heard < 50:
        select.select([client.fileno()], [], [], 0.05)
        heard += len(poses.samples())
    print("ready", flush=True)
    with realtime_priority(20):
        armed, plans, k = False, [], 0
        while True:
            ready, _, _ = select.select([client.fileno(), 0], [], [], 1.0)
            if 0 in ready:
                break
            samples = tuple(poses.samples())
            if not samples:
                continue
            if not armed or thrusters.trouble:
                thrusters.disarm()  # the turn of the bare ones was longer than the watchdog
                thrusters.trouble, armed = None, True
                thrusters.arm()
            health = thrusters.health()
            k, now = k + 1, clock.now
            if flown == "always" or k <= int(flown):
                plan = agent.step(Inputs(now, True, samples, setpoint, {}, health)).command
                plans.append(plan)
            else:
                until = now + plans[0].valid_until - plans[0].issued_at
                plan = replace(plans[k % len(plans)], seq=k, issued_at=now, valid_until=until)
            thrusters.apply(plan)
            poses.review()
"""


class Far:
    """The far end of one vehicle's serial line."""

    def __init__(self, tap):
        self.tap, self.decoder, self.plan = tap, Decoder(), None

    def serve(self):
        """Pass on; whether a new plan has come."""
        fresh = False
        try:
            data = os.read(self.tap.port_fd, 4096)
            os.write(self.tap.board_fd, data)
            for frame in self.decoder.feed(data):
                if frame.type == Cmd.CODE and (plan := frame.message.plan) != self.plan:
                    self.plan, fresh = plan, True
        except BlockingIOError:
            pass
        return fresh

    def back(self):
        with suppress(BlockingIOError):
            os.write(self.tap.port_fd, os.read(self.tap.board_fd, 4096))


def percentiles(values):
    return [float(np.percentile(values, share)) for share in (50, 99)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--vehicles", type=int, default=3)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--no-chain", action="store_true")
    args = parser.parse_args()
    experiment = load(find("zhang2023_table"), WORDS)
    flown = "50" if args.no_chain else "always"
    names = list(experiment.vehicles)[: args.vehicles]
    rng = np.random.default_rng(1)
    axes = Axes(MocapWire())
    with tempfile.TemporaryDirectory() as folder, steady_memory():
        taps = [
            LineTap(limits_of(experiment.vehicles[n].model), 1, Path(folder) / n).__enter__()
            for n in names
        ]
        fars = [Far(tap) for tap in taps]
        command = free_port(socket.SOCK_DGRAM)
        server = NatNetServer(
            NatNetAddress("127.0.0.1", command, free_port(socket.SOCK_DGRAM)), (4, 1),
            [Described(k + 1, n) for k, n in enumerate(names)],
        )  # fmt: skip
        chains = [
            subprocess.Popen(
                [sys.executable, "-c", CHAIN, n, f"{folder}/{n}", str(command), flown, *WORDS],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )
            for n in names
        ]  # fmt: skip
        bares, lines, ports = [], [], []
        for _ in names:
            line, other = pty.openpty()
            tty.setraw(other)
            ports.append(free_port(socket.SOCK_DGRAM))
            bares.append(
                subprocess.Popen(
                    [sys.executable, "-c", BARE, str(ports[-1]), os.ttyname(other)],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                )
            )  # fmt: skip
            lines.append(line)
        bare = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        number = 0

        def frame():
            nonlocal number
            number += 1
            now, bodies = monotonic_ns(), []
            for k, n in enumerate(names):
                x, y, theta = experiment.vehicles[n].start
                dx, dy = 2e-4 * rng.standard_normal(2)
                seen = axes.to_cameras(Pose(x + dx, y + dy, theta))
                bodies.append(RigidBody(k + 1, seen.position, seen.rotation, 2e-4, True))
            return MocapFrame(number, tuple(bodies), 1e-9 * now, now, now, now)

        def serve(until, waiting=None, sent=0, into=None):
            """Pass bytes on until then; note when each that is waited for has answered."""
            fds = [fd for tap in taps for fd in (tap.port_fd, tap.board_fd)]
            fds += [server.socket.fileno(), *lines]
            while (left := until - monotonic_ns()) > 0:
                ready, _, _ = select.select(fds, [], [], 1e-9 * left)
                now = monotonic_ns()
                for k, far in enumerate(fars):
                    if taps[k].port_fd in ready and far.serve() and waiting and ("c", k) in waiting:
                        waiting.discard(("c", k))
                        into.append(1e-3 * (now - sent))
                    if taps[k].board_fd in ready:
                        far.back()
                for k, line in enumerate(lines):
                    if line in ready:
                        os.read(line, 4096)
                        if waiting and ("b", k) in waiting:
                            waiting.discard(("b", k))
                            into.append(1e-3 * (now - sent))
                server.serve()

        ready = set()
        while len(ready) < 2 * len(names):
            server.send(frame())
            serve(monotonic_ns() + 10_000_000)
            pipes = {p.stdout: p for p in (*chains, *bares) if p not in ready}
            for pipe in select.select(list(pipes), [], [], 0)[0]:
                if pipe.readline() != b"ready\n":
                    raise RuntimeError(f"a process ended: {pipes[pipe].args[:4]}")
                ready.add(pipes[pipe])
        with realtime_priority(30):
            chain_us, bare_us, lost = [], [], 0
            period = round(1e9 / args.rate)
            due = monotonic_ns()
            per_turn = round(args.rate)
            for k in range(args.seconds * per_turn):
                due += period
                sleep_until_ns(due - period)
                turn, counts = (k // per_turn) % 2, k % per_turn >= SETTLE
                if turn == 0:
                    waiting = {("c", i) for i in range(len(names))}
                    data = encode_frame(frame(), (4, 1))
                    sent = monotonic_ns()
                    server.send_packet(data)
                    serve(due, waiting, sent, chain_us if counts else [])
                    lost += len(waiting) if counts else 0
                else:
                    waiting = {("b", i) for i in range(len(names))}
                    sent = monotonic_ns()
                    for port in ports:
                        bare.sendto(bytes(354), ("127.0.0.1", port))
                    serve(due, waiting, sent, bare_us if counts else [])
        for process in (*chains, *bares):
            process.stdin.close()
        for port in ports:
            bare.sendto(b"end", ("127.0.0.1", port))
        for process in (*chains, *bares):
            process.wait(20)
        for tap in taps:
            tap.__exit__(None, None, None)
    chain, raw = percentiles(chain_us), percentiles(bare_us)
    print(f"{len(names)} vehicles at {args.rate:g} Hz, {args.seconds} s, turns of one second")
    print(f"{'':28s}{'p50 [us]':>10s}{'p99 [us]':>10s}")
    print(f"{'bare UDP, bare pty':28s}{raw[0]:10.0f}{raw[1]:10.0f}")
    print(f"{'pose frame to valve command':28s}{chain[0]:10.0f}{chain[1]:10.0f}")
    print(f"{'ratio':28s}{chain[0] / raw[0]:10.2f}{chain[1] / raw[1]:10.2f}")
    print(f"answers {len(chain_us)} + {len(bare_us)}, missing within a period {lost}")


if __name__ == "__main__":
    main()
