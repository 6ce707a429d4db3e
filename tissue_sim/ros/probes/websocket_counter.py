"""A watcher of a page without drawing: counts the pictures that come over its websocket, as for a browser.

The program `python -m tissue_sim.ros.probes.websocket_counter ADDRESS SECONDS` prints a line when it begins to count,
and at the end, as JSON, when pictures of each organ came, s, and how many bytes.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator

from tissue_sim.json_types import JsonObject
from tissue_sim.ros.probes.graph import START_TIME, first_within
from tissue_sim.unexpected_errors import catch_all

SETTLING = 2.0  # s after the first picture, in which the page is still being filled
# First message of a browser; without it the page draws nothing.
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -1.0, 0.0),
    "fov": 0.6,
    "near": 0.01,
    "far": 100.0,
    "image_height": 800,
    "image_width": 1200,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


def pictures(message: bytes) -> Iterator[str]:
    """Yield the names of the organs whose pictures a message of the page brings; viser's protocol (viser.infra)."""
    import msgspec
    import zstandard

    whole, packed = (int.from_bytes(message[start : start + 8], "little") for start in (0, 8))
    text = zstandard.ZstdDecompressor().decompress(message[16 : 16 + packed], max_output_size=whole)
    for one in msgspec.msgpack.decode(text)["messages"]:
        if one["type"] == "SceneNodeUpdateMessage" and "glb_data" in one["updates"]:
            yield one["name"].rpartition("/")[0]


def watch(address: str, seconds: float) -> JsonObject:
    """Return when pictures come, monotonic s, by organ, and how many bytes, for some s from when it began.

    address: of the page, as the viewer prints it.
    """
    import msgspec
    import viser
    from websockets.sync.client import ClientConnection, connect

    def connected() -> ClientConnection | None:
        try:
            return connect(
                "ws" + address.removeprefix("http"),
                subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
                compression=None,
                max_size=None,
            )
        except OSError:
            return None

    came: dict[str, list[float]] = {}
    size, settled, began = 0, 0.0, 0.0  # s
    with first_within(connected, START_TIME, "nothing is served") as page:
        page.send(msgspec.msgpack.encode(CAMERA))
        while not began or time.monotonic() < began + seconds:
            message = page.recv(timeout=START_TIME, decode=False)
            now, whose = time.monotonic(), list(pictures(message))
            if whose and not settled:
                settled = now + SETTLING
            if settled and not began and now >= settled:
                began = now
                print("counting", flush=True)
            if began:
                size += len(message)
                for name in whose:
                    came.setdefault(name, []).append(now)
    return {"began": began, "came": came, "bytes": size}


def main(address: str, seconds: str) -> None:
    """Watch and print."""
    print(json.dumps(watch(address, float(seconds))))


if __name__ == "__main__":
    catch_all("page watcher")
    main(*sys.argv[1:3])
