"""Two network namespaces joined by a link with loss and delay: netem where the kernel has it, else a relay.

As a program, with LOSS DELAY ONE OTHER, it is that relay: it carries frames between two interfaces until SIGTERM, and
then prints how many it carried and lost.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import os
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tissue_sim.errors import UserError
from tissue_sim.unexpected_errors import catch_all

OWN_FRAME = 4  # PACKET_OUTGOING: frames that we sent ourselves
ALL_PROTOCOLS = 3  # ETH_P_ALL
SIOCETHTOOL, SET_TX_CHECKSUM = 0x8946, 0x17
ADDRESSES = "10.201.7.1", "10.201.7.2"  # of the two sides


class Unavailable(UserError):
    """Error that says why there is no such link on this machine."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"a lossy link needs network namespaces, and root: {reason}")


def run(*words: str) -> None:
    """Run a command; raise Unavailable when it fails, FileNotFoundError when there is none of that name."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Unavailable(f"'{' '.join(words)}': {done.stderr.strip() or done.returncode}")


@contextmanager
def lossy_link(loss: float, delay: float) -> Iterator[tuple[str, str]]:
    """Join two namespaces by a link that loses and delays frames, each way.

    loss: fraction of the frames that are lost; delay: delay of the others, s. Yields names of the two namespaces.
    Raises Unavailable when there can't be one on this machine.
    """
    tag = f"tissue{os.getpid()}"
    sides, middle = (f"{tag}a", f"{tag}b"), f"{tag}m"
    relay = None
    made = []
    try:
        for name in (*sides, middle):
            try:
                run("ip", "netns", "add", name)
            except FileNotFoundError:
                raise Unavailable("no command 'ip' (apt install iproute2)") from None
            made.append(name)
            run("ip", "-n", name, "link", "set", "lo", "up")
        for number, side in enumerate(sides):
            # eth0 of a side ends in the middle.
            run("ip", "-n", side, "link", "add", "eth0", "type", "veth", "peer", "name", f"to{number}", "netns", middle)
            run("ip", "-n", side, "addr", "add", f"{ADDRESSES[number]}/24", "dev", "eth0")
            run("ip", "-n", side, "link", "set", "eth0", "up")
            run("ip", "-n", side, "route", "add", "224.0.0.0/4", "dev", "eth0")
            run("ip", "-n", middle, "link", "set", f"to{number}", "up")
            # The relay sees frames before a checksum would be filled in on a real wire.
            run("ip", "netns", "exec", side, sys.executable, "-m", __name__, "--fill-checksums", "eth0")
        try:
            for number in range(2):
                words = [
                    "dev",
                    f"to{number}",
                    "root",
                    "netem",
                    "loss",
                    f"{100 * loss:g}%",
                    "delay",
                    f"{1000 * delay:g}ms",
                ]
                run("tc", "-n", middle, "qdisc", "add", *words)
            words = ["0", "0"]
        except (Unavailable, FileNotFoundError):
            words = [str(loss), str(delay)]  # this kernel has no netem
        relay = subprocess.Popen(
            ["ip", "netns", "exec", middle, sys.executable, "-m", __name__, *words, "to0", "to1"], stdout=2
        )
        yield sides
    finally:
        if relay is not None:
            relay.terminate()
            relay.wait(10.0)
        for name in made:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@contextmanager
def inside(namespace: str) -> Iterator[None]:
    """Move this thread, and what it starts meanwhile, to a network namespace. namespace: its name."""
    with open("/proc/thread-self/ns/net") as own, open(f"/run/netns/{namespace}") as other:
        os.setns(other.fileno(), os.CLONE_NEWNET)
        try:
            yield
        finally:
            os.setns(own.fileno(), os.CLONE_NEWNET)


def carry(loss: float, delay: float, names: tuple[str, str]) -> None:
    """Carry frames both ways until SIGTERM."""
    ends = []
    for name in names:
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        end.bind((name, 0))
        ends.append(end)
    stop: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stop.append(1))
    chance = random.Random(1)
    waiting: list[tuple[float, int, socket.socket, bytes]] = []
    carried = lost = 0
    while not stop:
        wait = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.1
        ready, _, _ = select.select(ends, [], [], wait)
        for end in ready:
            frame, address = end.recvfrom(65536)
            if address[2] == OWN_FRAME:
                continue
            if chance.random() < loss:
                lost += 1
                continue
            carried += 1
            other = ends[1 - ends.index(end)]
            heapq.heappush(waiting, (time.monotonic() + delay, carried, other, frame))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, other, frame = heapq.heappop(waiting)
            other.send(frame)
    print(f"relay: {carried} frames carried, {lost} lost", flush=True)


def fill_checksums(name: str) -> None:
    """Let the kernel fill in checksums of the frames that leave an interface."""
    command = bytearray(struct.pack("II", SET_TX_CHECKSUM, 0))
    buffer = (ctypes.c_char * len(command)).from_buffer(command)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCETHTOOL, struct.pack("16sP", name.encode(), ctypes.addressof(buffer)))


if __name__ == "__main__":
    catch_all("lossy_link")
    if sys.argv[1] == "--fill-checksums":
        fill_checksums(sys.argv[2])
    else:
        carry(float(sys.argv[1]), float(sys.argv[2]), (sys.argv[3], sys.argv[4]))
