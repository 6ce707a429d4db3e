"""`tissue_node`: serves one organ at a fixed rate.

Threads: the physics loop (compiled, without the GIL); the contact worker (FCL); the outlet (markers,
fading wrenches, journal, diagnostics); and the executor here, whose callbacks leave the newest
pose and publish the newest wrench.
"""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path
from typing import Any

from std_srvs.srv import SetBool, Trigger

import tissue_sim
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.jit import is_compiled
from tissue_sim.model.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.bound import Bound
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.bags.writer import Split
from tissue_sim.ros.node.contact_kernels import compile_beside
from tissue_sim.ros.node.contact_worker import ContactWorker
from tissue_sim.ros.node.diagnostics import Diagnostics, LoopReport
from tissue_sim.ros.node.guarded import GuardedNode
from tissue_sim.ros.node.live_settings import LiveSettings
from tissue_sim.ros.node.namesakes import Namesakes
from tissue_sim.ros.node.outlet import Outlet
from tissue_sim.ros.node.presenter import Presenter
from tissue_sim.ros.node.served_tool import ServedTool
from tissue_sim.ros.node.sim_clock import SimClock
from tissue_sim.ros.node.tf_broadcast import TfBroadcast
from tissue_sim.ros.node.tf_lookup import TfLookup, tf_installed
from tissue_sim.ros.node.tool_port import ToolPort
from tissue_sim.ros.shared.dds import told_reach
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.parameters import Parameters, frames_of, placed_frames, tool_of, topics_of
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.priority import below, prefer
from tissue_sim.ros.shared.report import Report, Reports

NAME = "tissue_sim"
BAG_PATIENCE = 0.4  # s that the bag's queue gets at the end; what it holds then is left out


class TissueNode(GuardedNode):
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
        tools = ToolSet([tool_of(values, name) for name in values.tools])
        if not is_compiled():
            self.get_logger().info("compiling the kernels, once for this machine: half a minute")
            self._beside = compile_beside(self.organ_path)
        self.simulation = Simulation(
            self.organ,
            model=values["model"],
            rate=values["rate"],
            local_region=values["local_region"],
            shapes=tools.shapes,
            return_target=values["return_target"],
            integrator=values["integrator"],
            gravity=values["gravity"],
            shape_gravity=[0.0, 0.0, 0.0] if values["shape_is_unloaded"] else None,
        )
        values.apply(self.simulation.settings)
        self.simulation.set_substeps()
        self.loop = Loop([self.simulation])
        self.physics = Physics(self.loop)
        self._lookup = TfLookup(self, values.tf_target) if tf_installed() else None
        self._woken = threading.Event()
        self.sim_clock = SimClock(self, self.loop)
        self.recorder = Recorder(self.get_fully_qualified_name(), self.physics.n_bodies, self._config())
        self.ports = [self._port(index, name, tools) for index, name in enumerate(values.tools)]
        finder = ContactFinder(self.organ.rest_positions, self.organ.surface_triangles, self.organ.n_surface, tools)
        self.contacts = ContactWorker(
            finder, self.physics, self.ports, self.recorder, self._woken, self.get_logger().warning
        )
        self.finder = finder
        broadcast = None
        if values["broadcast_tf"] and tf_installed():
            broadcast = TfBroadcast(self, self.frame_id, values.tools, placed_frames(values, values.tools))
        self.presenter = Presenter(
            self, self.organ, self.frame_id, self.physics, self.ports, self.recorder, tools, broadcast
        )
        self.diagnostics = Diagnostics(self, self.organ.name)
        self.live = LiveSettings(
            self.simulation,
            self.physics,
            values,
            self._post_settings,
            [port.pose_freshness for port in self.ports],
        )
        self.namesakes = Namesakes(self)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        self._bags = Bound(values["record_folder"])
        values.checks["record_folder"] = self._bags.inside
        values.changed.append(self._on_parameters)
        self._outlet: Outlet | None = None
        self._parts: list[Reports] = []

    # life --------------------------------------------------------------------------------------
    def start(self) -> None:
        """Start the threads; returns when the loop runs. To be called by the thread that spins the node."""
        self.live.update()
        self.loop.start()
        self.finder.warm_up(self.organ.rest_positions)  # after the tick, beside which its kernels were compiled
        self._prefer(self.parameters["realtime_priority"])
        outlet = self._outlet = Outlet(
            self.parameters,
            self.physics,
            self.ports,
            self.presenter,
            self.live,
            self.sim_clock,
            partial(self.recorder.poll, self.physics),
            self._report,
            self.get_logger(),
        )
        self._parts = [
            LoopReport(self.physics),
            self.sim_clock,
            self.live,
            self.namesakes,
            *self.ports,
            self.recorder,
            self.contacts,
            self.presenter,
            outlet,
            self.mishaps,
        ]
        self.contacts.rate = self.parameters["contact_rate"]
        self.contacts.start()
        if self.parameters["record"]:
            self.get_logger().info(f"recording to {self._start_recording()}")
        outlet.start()
        organ = self.organ
        self.get_logger().info(
            f"organ '{organ.name}': {organ.n_surface} surface nodes, {organ.n_atoms} medial atoms;"
            f" model {self.simulation.variant}, {self.simulation.rate:g} Hz,"
            f" {int(self.simulation.settings.substeps)} substeps; tools: {', '.join(self.parameters.tools)};"
            f" {told_reach()}"
        )

    def close(self) -> None:
        """Leave no force standing, close the bag, delete the markers, end the threads; well under a second."""
        noted = self.mishaps.noted  # where one of them fails, the others are done
        if self._outlet is not None:
            self._outlet.stop()
        for port in self.ports:
            with noted():
                port.output.publish_zero()
        with noted():
            self.presenter.close()
        self.contacts.stop()
        with noted():
            self._close_bag()
        self.loop.stop()

    def _close_bag(self) -> None:
        path = self.recorder.stop(self.physics, BAG_PATIENCE)
        if path is not None and self.recorder.error:
            self.get_logger().error(self.recorder.error)
        elif path is not None:
            lost = f", without {self.recorder.lost} messages" if self.recorder.lost else ""
            self.get_logger().info(f"bag closed: {path}{lost}")

    def _prefer(self, priority: int) -> None:
        """The loop before all other threads, and after it the calling one, which answers poses."""
        try:
            self.loop.prefer(priority)
            prefer(below(priority))
        except OSError as error:
            self.get_logger().warning(
                f"realtime_priority {priority} is refused ({error.strerror}): the loop is a thread like others;"
                " allow it with a line like '@haptics - rtprio 99' in /etc/security/limits.conf, and log in again"
            )

    # wiring ------------------------------------------------------------------------------------
    def _port(self, index: int, name: str, tools: ToolSet) -> ToolPort:
        values = self.parameters
        topics, frames = topics_of(values, name), frames_of(values, name, self._lookup)
        tool = ServedTool(index, name, tools, topics, frames, self.frame_id)
        return ToolPort(self, tool, self.physics, self.recorder, self.sim_clock, self._woken)

    def _config(self) -> dict[str, Any]:
        return {
            "format": bag.FORMAT,
            "package_version": tissue_sim.__version__,
            "node": self.get_fully_qualified_name(),
            "organ": {"name": self.organ.name, "digest": self.organ.digest()},
            "parameters": self.parameters.values(),
            "shape_gravity": self.simulation.model.shape_gravity.tolist(),
            "tools": self.parameters.tools,
        }

    # services and parameters -------------------------------------------------------------------
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.loop.reset()
        response.success, response.message = True, "the organ is back at rest"
        return response

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                response.success, response.message = True, str(self._start_recording())
            else:
                path, error = self.recorder.stop(self.physics), self.recorder.error
                response.success = path is not None and not error
                response.message = error or (str(path) if path is not None else "nothing was being recorded")
        except UserError as error:
            response.success, response.message = False, str(error)
        return response

    def _start_recording(self) -> Path:
        newest = {name: message for port in self.ports for name, message in port.input.newest_messages().items()}
        values = self.parameters
        folder = self._bags.inside(values["record_folder"])  # a link may lead elsewhere by now
        split = Split(1e6 * values["record_split_size"], values["record_split_duration"])
        return self.recorder.start(folder, self.physics, self._organ_bytes, self.presenter.mesh_bytes, newest, split)

    def _post_settings(self, settings: Settings) -> None:
        with self.recorder.together:
            self.recorder.settings(self.physics.post_settings(settings), settings)

    def _on_parameters(self, _: set[str]) -> None:
        self.contacts.rate = self.parameters["contact_rate"]
        self.live.update()

    def _report(self) -> None:
        if self.parameters["coupling_stiffness"] > 0.0:
            self.live.update()  # poses may come at another rate now
        report = Report()
        for part in self._parts:
            part.report(report)
        self.diagnostics.publish(report)
