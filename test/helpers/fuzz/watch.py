"""Side effects of an input: files outside its folder, programs, connections."""

import ctypes
import os
import struct
import sys
from pathlib import Path

_OPENED, _CREATED, _REMOVED = 0x20, 0x100, 0x200  # of inotify(7)
_EVENT = struct.Struct("iIII")
ELSEWHERE = "/etc/passwd"  # a file that an input may name, and that must not be opened
_FORBIDDEN = ("os.system", "os.exec", "os.posix_spawn", "subprocess.Popen", "socket.connect", "urllib.Request")

_libc = ctypes.CDLL(None, use_errno=True)


class Watch:
    """Observer of a folder, not of its subfolders: what is opened, made or removed there, by whatever library.

    It also observes programs and connections, where Python starts them; only while it is `armed`.
    """

    def __init__(self, folder: Path) -> None:
        self.armed = False
        self._seen: list[str] = []
        self._events = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        _libc.inotify_add_watch(self._events, os.fsencode(folder), _OPENED | _CREATED | _REMOVED)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple) -> None:
        if self.armed and (event in _FORBIDDEN or (event == "open" and arguments[0] == ELSEWHERE)):
            self._seen.append(f"{event} {arguments[0]!r:.60}")

    def seen(self, own: frozenset[str]) -> list[str]:
        """What happened since the last call, except for the names `own`."""
        found, self._seen = self._seen, []
        try:
            data = os.read(self._events, 1 << 16)
        except BlockingIOError:
            data = b""
        at = 0
        while at < len(data):
            _, mask, _, length = _EVENT.unpack_from(data, at)
            at += _EVENT.size + length
            name = os.fsdecode(data[at - length : at].rstrip(b"\0"))
            if name and name not in own:
                how = "opened" if mask & _OPENED else "made" if mask & _CREATED else "removed"
                found.append(f"{how} {name} outside of its folder")
        return list(dict.fromkeys(found))
