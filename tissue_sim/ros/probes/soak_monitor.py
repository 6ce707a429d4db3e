"""Watch of a node in a long run: its memory, its reports, the surface that it shows."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.errors import UserError
from tissue_sim.ros.probes.graph import first_within

if TYPE_CHECKING:
    from rclpy.node import Node

PATIENCE = 30.0  # s for the node to answer, or for the organ to come to rest
# Counters in the diagnostics that stay at 0 while nothing is wrong, as do those whose names contain these parts.
PROBLEMS = "faults", "false_rest_shapes", "clamped_ticks", "dropped_contacts", "lost_bag_messages"
PROBLEM_PARTS = "_failures", ".refused."


class Sample(NamedTuple):
    """A sample of the node's state."""

    seconds: float  # since the watch began
    megabytes: float  # resident memory of its own
    shared_megabytes: float  # resident memory shared with others: the middleware's segments
    ticks: int  # so far
    late: int  # of these by more than a period, so far
    late_us: float  # 99th percentile of the last second
    dropped: int  # ticks that were dropped, so far


def resident(process: int) -> tuple[float, float]:
    """Return the resident memory of a running process, its own and what it shares with others, MB.

    Mapped files, such as libraries, count for neither.

    process: number of the process. Raises UserError when it has ended.
    """
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines()
        fields = dict(line.split(":", 1) for line in lines)
        own, shared = (int(fields[name].split()[0]) * 1024e-6 for name in ("RssAnon", "RssShmem"))
    except (OSError, KeyError):
        raise UserError(f"memory of process {process} can't be read: it has ended") from None
    return own, shared


class Watch:
    """Observer of a node from a rclpy node of this process that nothing spins.

    process: number of its process.
    """

    def __init__(self, node: Node, target: str, process: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import PointCloud2
        from std_srvs.srv import SetBool

        from tissue_sim.ros.shared.client import NewestMessage, stream_qos

        self._node, self._target, self._process = node, target, process
        self._reports = NewestMessage(node, DiagnosticArray, "/diagnostics", 10)  # type: ignore[arg-type]
        self._surfaces = NewestMessage(node, PointCloud2, f"/{target}/surface", stream_qos())
        self._record = node.create_client(SetBool, f"/{target}/record")
        self._began = time.monotonic()
        self.values: dict[str, str] = {}  # of the newest report
        self.failures: list[str] = []  # errors of the reports, each once

    def hear(self) -> bool:
        """Take the reports that have come; return whether there was one."""
        from tissue_sim.ros.shared import client

        reports = self._reports.take_all()
        for report in reports:
            status = client.newest_status([report], self._target)
            if status is not None and status.level == status.ERROR and status.message not in self.failures:
                self.failures.append(status.message)
        self.values = client.physics_status(reports, self._target) or self.values
        return bool(reports)

    def sample(self) -> Sample:
        """Take a sample of the node. Raises UserError when it has ended or sends no report."""
        self.hear()
        memory = resident(self._process)
        first_within(lambda: self.values or (self.hear() and self.values), PATIENCE, "the node sent no diagnostics")
        values = self.values
        return Sample(
            time.monotonic() - self._began,
            *memory,
            int(values["tick"]),
            int(values["overruns"]),
            float(values["late_p99_us"]),
            int(values["dropped_ticks"]),
        )

    def problems(self) -> dict[str, int]:
        """Return the counters of the newest report that should be 0 and are not."""
        counts = {
            name: int(value)
            for name, value in self.values.items()
            if name in PROBLEMS or any(part in name for part in PROBLEM_PARTS)
        }
        return {name: count for name, count in counts.items() if count}

    def at_rest(self) -> NDArray[np.float32]:
        """Return the surface once the organ sleeps, (n, 3) m. Raises UserError when it does not come to rest."""
        self.values = {}
        first_within(
            lambda: self.hear() and self.values.get("region") == "asleep", PATIENCE, "the organ did not come to rest"
        )
        self._surfaces.take_all()
        return self.surface()

    def surface(self) -> NDArray[np.float32]:
        """Return the next surface, (n, 3) m. Raises UserError when none comes."""
        from tissue_sim.ros.shared import client

        return client.cloud_array(first_within(self._surfaces.take, PATIENCE, "the node sent no surface"))[:, :3]

    def force_clamp(self) -> float:
        """Return the largest force, N, that the node may publish. Raises UserError when it does not answer."""
        from tissue_sim.ros.shared.node_parameters import NodeParameters

        values = first_within(NodeParameters(self._node, self._target).poll, PATIENCE, "the node sent no parameters")
        return float((values or {})["force_clamp"])

    def close_bag(self) -> Path:
        """End the recording; return the bag's folder. Raises UserError when the node does not, or can't."""
        import rclpy
        from std_srvs.srv import SetBool

        first_within(self._record.service_is_ready, PATIENCE, "the node's service ~/record was not found")
        asked = self._record.call_async(SetBool.Request(data=False))
        rclpy.spin_until_future_complete(self._node, asked, timeout_sec=PATIENCE)
        if not asked.done():
            raise UserError(f"the bag was not closed within {PATIENCE:g} s")
        answer = asked.result()
        if not answer.success:
            raise UserError(f"the bag was not closed: {answer.message}")
        return Path(answer.message)
