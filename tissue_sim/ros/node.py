"""`tissue_node`: serves one organ at a fixed rate.

Threads: the physics loop (compiled, without the GIL); the contact worker (FCL); the outlet (markers,
fading wrenches, journal, diagnostics); and the executor here, whose callbacks leave the newest
pose and publish the newest wrench.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

import tissue_sim
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.jit import is_compiled
from tissue_sim.model import state as st
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros import bag
from tissue_sim.ros.contact_worker import ContactWorker
from tissue_sim.ros.dds import use_shipped_profile
from tissue_sim.ros.diagnostics import Diagnostics, physics_values
from tissue_sim.ros.parameters import SETTING_OF, Parameters
from tissue_sim.ros.physics import Physics
from tissue_sim.ros.presenter import Presenter
from tissue_sim.ros.recorder import Recorder
from tissue_sim.ros.tool_port import ToolPort, as_values

NAME = "tissue_sim"
SILENCE = 0.003  # s without a wrench after which the outlet goes on publishing it


class TissueNode(Node):
    """The node: wires parameters, simulation, tools and topics together.

    Raises UserError for a parameter or file that can't be used.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        self.parameters = Parameters(self)
        values = self.parameters
        self.frame_id: str = values["frame_id"]
        self.organ_path = Path(values["organ_file"] or shipped_organ())
        self.organ = Organ.load(self.organ_path)
        self._organ_bytes = self.organ_path.read_bytes()
        tools = ToolSet([values.tool(name) for name in values.tools])
        for warning in tools.warnings:
            self.get_logger().warning(warning)
        if not is_compiled():
            self.get_logger().info("compiling the kernels, once for this machine: up to 30 s")
        self.simulation = Simulation(
            self.organ,
            values["model"],
            values["rate"],
            values["local_region"],
            tools.shapes,
            values["return_target"],
            values["integrator"],
        )
        values.apply(self.simulation.settings)
        self.simulation.set_substeps()
        self.physics = Physics(self.simulation)
        self._woken, self._stop = threading.Event(), threading.Event()
        self.ports = [self._port(index, name) for index, name in enumerate(values.tools)]
        self.recorder = Recorder(self.get_fully_qualified_name(), values.tools, self._tool_topics(), self._config())
        finder = ContactFinder(self.organ.rest_positions, self.organ.surface_triangles, self.organ.n_surface, tools)
        self.contacts = ContactWorker(
            finder, self.physics, self.ports, lambda: self.recorder, self._woken, self.get_logger().warning
        )
        self.finder = finder
        self.presenter = Presenter(self, self.organ, self.frame_id, self.physics, self.ports, lambda: self.recorder)
        self.diagnostics = Diagnostics(self, self.organ.name)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        values.changed.append(self._on_parameters)
        self._outlet = threading.Thread(target=self._run_outlet, name="outlet", daemon=True)

    # life --------------------------------------------------------------------------------------
    def start(self) -> None:
        """Start the threads; returns when the first tick is done."""
        self.finder.warm_up(self.organ.rest_positions)
        self.physics.start()
        self.contacts.start()
        if self.parameters["record"]:
            self.get_logger().info(f"recording to {self._start_recording()}")
        self._outlet.start()
        organ = self.organ
        self.get_logger().info(
            f"organ '{organ.name}': {organ.n_surface} surface nodes, {organ.n_atoms} medial atoms;"
            f" model {self.parameters['model']}, {self.simulation.rate:g} Hz,"
            f" {int(self.simulation.settings[st.WANTED_SUBSTEPS])} substeps; tools: {', '.join(self.parameters.tools)}"
        )

    def close(self) -> None:
        """Leave no force standing, close the bag, delete the markers, end the threads."""
        self._stop.set()
        if self._outlet.is_alive():
            self._outlet.join(timeout=2.0)
        for port in self.ports:
            port.publish_zero()
        self.presenter.close()
        self.contacts.stop()
        path = self.recorder.stop(self.physics)
        self.physics.stop()
        if path is not None:
            self.get_logger().info(f"bag closed: {path}")

    # wiring ------------------------------------------------------------------------------------
    def _port(self, index: int, name: str) -> ToolPort:
        values = self.parameters
        return ToolPort(
            self,
            index,
            name,
            values[f"{name}.frame_id"] or self.frame_id,
            {topic: values.topic(name, topic) for topic in bag.TOOL_TOPICS},
            values[f"{name}.reliable"],
            self.physics,
            lambda: self.recorder,
            self._woken,
        )

    def _tool_topics(self) -> dict[tuple[str, str], str]:
        return {(port.name, topic): port.names[topic] for port in self.ports for topic in bag.TOOL_TOPICS}

    def _config(self) -> dict[str, Any]:
        return {
            "format": bag.FORMAT,
            "package_version": tissue_sim.__version__,
            "node": self.get_fully_qualified_name(),
            "organ": {"name": self.organ.name, "digest": self.organ.digest()},
            "parameters": self.parameters.values(),
            "tools": self.parameters.tools,
            "topics": {f"{tool}/{topic}": name for (tool, topic), name in self._tool_topics().items()},
        }

    # services and parameters -------------------------------------------------------------------
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.physics.reset()
        response.success, response.message = True, "the organ is back at rest"
        return response

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                response.success, response.message = True, str(self._start_recording())
            else:
                path = self.recorder.stop(self.physics)
                response.success = path is not None
                response.message = str(path) if path is not None else "nothing was being recorded"
        except UserError as error:
            response.success, response.message = False, str(error)
        return response

    def _start_recording(self) -> Path:
        newest = {}
        for port in self.ports:
            for topic, (sequence, raw) in (
                ("measured_cp", (port.newest[0], port.newest[2])),
                ("measured_cf", port.newest_force),
            ):
                if raw:
                    newest[port.names[topic]] = (sequence, raw)
        folder = Path(self.parameters["record_folder"]).absolute()
        return self.recorder.start(folder, self.physics, self._organ_bytes, self.presenter.mesh_bytes, newest)

    def _on_parameters(self, changed: dict[str, Any]) -> None:
        settings = self.physics.settings()
        for name, value in changed.items():
            if name in SETTING_OF:
                settings[SETTING_OF[name]] = value
        if "stiffness_scale" in changed:
            self.simulation.settings[:] = settings
            self.simulation.set_substeps()
            settings = self.simulation.settings.copy()
        self.contacts.rate = changed.get("contact_rate", self.contacts.rate)
        if any(name in SETTING_OF for name in changed):
            sequence = self.physics.post_settings(settings)
            self.recorder.settings(sequence, settings)

    # the outlet --------------------------------------------------------------------------------
    def _run_outlet(self) -> None:
        """Markers at their rate, fading wrenches at the tick rate, journal, diagnostics at 1 Hz."""
        tick_time = 1.0 / self.simulation.rate
        next_marker = next_report = time.monotonic()
        self.contacts.rate = self.parameters["contact_rate"]
        while not self._stop.is_set():
            fading = [port.keep_publishing(SILENCE) for port in self.ports]
            now = time.monotonic()
            if now >= next_marker:
                next_marker = max(next_marker + 1.0 / self.parameters["marker_rate"], now)
                self.presenter.present(self.parameters["record_markers"], self.parameters["marker_colour"])
                self.recorder.poll(self.physics)
            if now >= next_report:
                next_report = max(next_report + 1.0, now)
                self._report()
            wait = next_marker - time.monotonic()
            if any(fading):
                wait = min(wait, tick_time)
            if wait > 0.0:
                self._stop.wait(wait)

    def _report(self) -> None:
        count, tools = self.physics.counts()
        settings = self.physics.settings()
        values = physics_values(self.physics.timing(), count)
        values["force_n"] = float(sum(port.force for port in self.ports))
        values["recording"] = str(self.recorder.path) if self.recorder.active else ""
        durations = self.contacts.durations[-250:]
        values["contact_p99_us"] = 1e6 * float(np.percentile(durations, 99)) if durations else 0.0
        counters = self.finder.counters
        values |= {
            "last_fault": st.FAULT_NAMES[int(count[st.FAULT_KIND])],
            "turned_cells": int(count[st.TURNED]),
            "contact_sets": counters.sets,
            "skipped.tool_far": counters.far_skips,
            "skipped.contacts_unchanged": self.contacts.unchanged_skips,
            "skipped.mesh_unchanged": self.presenter.unchanged_skips,
            "skipped.no_subscriber": self.presenter.unseen_skips,
        }
        problems = {
            "faults": int(count[st.FAULTS]),
            "false_rest_shapes": int(count[st.SNAPS]),
            "clamped_ticks": int(count[st.CLAMPED]),
            "dropped_contacts": self.contacts.dropped,
            "lost_bag_messages": self.recorder.lost,
        }
        for port in self.ports:
            engaged = bool(tools[port.index, st.ENGAGED])
            values |= {
                f"{port.name}.state": port.state(settings, engaged),
                f"{port.name}.force_n": port.force,
                f"{port.name}.poses": port.poses,
            }
            problems |= as_values(port.refused, port.name)
        failure = self.recorder.error or self.contacts.error
        if not self.physics.alive:
            failure = "the physics loop has ended"
        self.diagnostics.publish(values, problems, failure)


def main(arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; returns the exit code."""
    words = sys.argv if arguments is None else arguments
    if any(word in ("-h", "--help") for word in words[1:]):
        print(HELP)
        return 0
    # Short turns at the GIL: a pose must not wait 5 ms for a diagnostics message.
    sys.setswitchinterval(0.0005)
    stop = threading.Event()
    use_shipped_profile()
    rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    node = None
    try:
        node = TissueNode()
        executor = EventsExecutor()
        executor.add_node(node)
        node.start()
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.1)
        node.close()
        return 0
    except UserError as error:
        sys.stderr.write(f"tissue_node: error: {error}\n")
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


HELP = """usage: tissue_node [--ros-args -p PARAMETER:=VALUE ... --params-file FILE -r OLD:=NEW ...]

Serves a deformable organ at a fixed rate: tool poses in, wrenches and the deformed mesh out.
Parameters (defaults: the kidney that ships, 1000 Hz, spherical tools 'left' and 'right' of 5 mm):
"""


def _describe_parameters() -> str:
    from tissue_sim.ros.parameters import NODE_SPECS, TOOL_SPECS

    def line(prefix: str, spec: Any) -> str:
        bounds = f" [{spec.low:g}..{spec.high:g}]" if spec.low is not None else ""
        live = ", may change while running" if spec.live else ""
        return f"  {prefix}{spec.name} (default {spec.default!r}){bounds}{live}: {spec.text}"

    lines = [line("", spec) for spec in NODE_SPECS]
    lines.append("  tools (default ['left', 'right']): names of the tools")
    lines += [line("<tool>.", spec) for spec in TOOL_SPECS]
    return "\n".join(lines)


HELP += _describe_parameters()

if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # the wheels' DDS threads may outlive the interpreter otherwise
