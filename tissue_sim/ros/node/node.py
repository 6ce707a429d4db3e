"""The node `tissue_node`: serves one organ, or those of a scene, at a fixed rate.

Threads: the physics loop (compiled, without the GIL); the contact worker (FCL); the publishing thread (markers, fading
wrenches, journal, diagnostics); the wrench replies (a wrench for the pose that a tick applied); and the executor here,
whose callbacks store the newest pose.
"""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path

from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.pressed_points import warm_up
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.jit import is_compiled
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.settings import Settings
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.tool_resolution import mean_edge, unresolved_tools_of
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.folder_bound import Bound
from tissue_sim.ros.bags.recorder import NOT_KEPT, Recorder
from tissue_sim.ros.bags.writer import Split
from tissue_sim.ros.node.contact.contact_search import ContactSearch, OrganContactSearch
from tissue_sim.ros.node.contact.contact_worker import ContactWorker
from tissue_sim.ros.node.input.followed_frame import FollowedFrame
from tissue_sim.ros.node.input.respiration import RespirationInput
from tissue_sim.ros.node.input.tf_lookup import TfLookup, tf_installed
from tissue_sim.ros.node.output.contact_kernels import compile_beside
from tissue_sim.ros.node.output.contact_points import ContactPoints
from tissue_sim.ros.node.output.diagnostics import Diagnostics, LoopReport
from tissue_sim.ros.node.output.organ_publisher import OrganPublisher, ScenePublisher
from tissue_sim.ros.node.output.publishing_thread import PublishingThread
from tissue_sim.ros.node.output.tf_broadcast import TfBroadcast
from tissue_sim.ros.node.output.tool_publisher import ToolPublisher
from tissue_sim.ros.node.services import simulation_services
from tissue_sim.ros.node.services.cutting import CuttingParts, OrganCutting
from tissue_sim.ros.node.services.entities import Entities
from tissue_sim.ros.node.services.pausing import NEXT_TICK, Pausing
from tissue_sim.ros.node.settings.live_settings import LiveSettings
from tissue_sim.ros.node.shared.backlog import Backlog, executor_of
from tissue_sim.ros.node.shared.duplicate_nodes import DuplicateNodes
from tissue_sim.ros.node.shared.guarded_node import GuardedNode
from tissue_sim.ros.node.shared.served_organ import ServedOrgan, ServedScene, described
from tissue_sim.ros.node.shared.served_tool import ServedTool
from tissue_sim.ros.node.shared.shared_parts import SharedParts
from tissue_sim.ros.node.shared.sim_clock import SimClock
from tissue_sim.ros.node.tools.passivity import DevicePort
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.node.tools.wrench_replies import WrenchReplies
from tissue_sim.ros.shared.dds import describe_discovery
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.parameter_values import frames_of, frames_of_node, placed_frames, tool_of, topics_of
from tissue_sim.ros.shared.parameters import Parameters
from tissue_sim.ros.shared.priority import below, prefer
from tissue_sim.ros.shared.qos import LATCHED
from tissue_sim.ros.shared.report import Report, Reports
from tissue_sim.version import __version__

NAME = "tissue_sim"
BAG_PATIENCE = 0.4  # s for writing the bag's queue at the end; the rest of it is left out


class TissueNode(GuardedNode):
    """The node: connects parameters, simulation, tools and topics.

    Raises UserError when a parameter or file can't be used.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        self.parameters = Parameters(self)
        self.decided = self.parameters.decided
        values = self.parameters
        self.frame_id: str = values["frame_id"]
        tools = ToolSet([tool_of(values, name) for name in values.tools])
        if not is_compiled():
            self.get_logger().info("compiling the kernels, once for this version")
            any_organ = Path(values["organ_file"] or shipped_organ())
            self._beside = compile_beside(any_organ) if any_organ.is_file() else None
        self.scene = ServedScene.of_parameters(values, tools.shapes)
        values.report_organs([name for name in self.scene.names if name])
        self.scene.apply(values)
        self.scene.joined.set_substeps()
        self.loop = Loop(self.scene.joined)
        self.organs = Organs(self.loop)
        self.served = [
            ServedOrgan(name, physics) for name, physics in zip(self.scene.names, self.organs.each, strict=True)
        ]
        self._lookup = TfLookup(self, values.tf_target) if tf_installed() else None
        self._woken, self.backlog = threading.Event(), Backlog(executor_of(self))
        self.sim_clock = SimClock(self, self.loop)
        self.recorder = Recorder(self.get_fully_qualified_name(), self.organs, self.scene.names, self._config())
        self.shared = SharedParts(self, self.organs, self.recorder, self.sim_clock, self.backlog)
        self.ports = [self._port(index, name, tools) for index, name in enumerate(values.tools)]
        warn, of_organ = self.get_logger().warning, self.recorder.of_organ
        searches = [
            ContactSearch(self._finder(one.organ, tools), one, self.ports, recorder)
            for one, recorder in zip(self.served, of_organ, strict=True)
        ]
        joined = self.recorder.joined
        pairs = None if self.scene.joined.alone else OrganContactSearch(self.organs, joined)
        self.contacts = ContactWorker(searches, pairs, self.ports, self._woken, warn)
        self.answers = WrenchReplies(self.organs, self.ports, self._woken, warn)
        self._warm_up = [
            partial(one.finder.warm_up, served.organ.rest_positions)
            for one, served in zip(searches, self.served, strict=True)
        ]
        self.respiration = None
        if self.scene.joined.carried.breath.follows:
            self.respiration = RespirationInput(self, self.loop, joined, self.sim_clock)
        self._broadcast = TfBroadcast(self) if values["broadcast_tf"] and tf_installed() else None
        self._registrations = 0  # how often organ_pose changed
        self._place_frames()
        self.presenters: list[OrganPublisher | ScenePublisher] = [
            OrganPublisher(self, one, self.frame_id, self.ports, recorder, values)
            for one, recorder in zip(self.served, of_organ, strict=True)
        ]
        if self.scene.is_scene:
            self.presenters.append(ScenePublisher(self, self.served, self.frame_id, self.ports, self.organs, values))
        self.tool_presenter = ToolPublisher(self, self.frame_id, self.organs, self.ports, tools, self._broadcast)
        self.contact_points = ContactPoints(self, self.frame_id, self.organs, tools)
        self._warm_up.append(partial(warm_up, tools.shapes))
        self._ready = self.create_publisher(Bool, "~/ready", LATCHED)
        self._ready.publish(Bool(data=False))
        self.diagnostics = Diagnostics(self, self.scene.title)
        freshness = [port.pose_freshness for port in self.ports]
        self.live = LiveSettings(self.scene, values, self._post_settings, freshness)
        self.cutting = self._cutting()
        self.loop.before_reset += [one.heal for one in self.cutting]
        self.namesakes = DuplicateNodes(self)
        self.pausing = Pausing(self, self.loop, self.sim_clock, lambda: values["step_ticks"], self.contacts)
        if simulation_services.installed():
            entities = Entities(self, values, self.served, self.ports)
            simulation_services.SimulationServices(self, self.loop, self.pausing, entities)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/record", self._on_record)
        self._bags = Bound(values["record_folder"])
        values.checks["record_folder"] = self._bags.inside
        values.changed.append(self._on_parameters)
        self._outlet: PublishingThread | None = None
        self._parts: list[Reports] = []

    # life --------------------------------------------------------------------------------------
    def start(self) -> None:
        """Start the threads; return when the loop runs. To be called by the thread that spins the node."""
        self.live.update()
        self.loop.start()
        self.answers.start()
        for compile_kernels in self._warm_up:  # after the tick, beside which they were compiled
            compile_kernels()
        self._prefer(self.parameters["realtime_priority"])
        tools = self.tool_presenter
        show = [*(one.present for one in self.presenters), tools.present, tools.broadcast_tips]
        show += [self.contact_points.present, self.recorder.poll]
        outlet = self._outlet = PublishingThread(self.shared, self.ports, show, self.live, self._report)
        self._parts = [
            *self.ports,
            self.contact_points,
            LoopReport(self.organs, self.scene.names, [one.name or one.organ.name for one in self.served]),
            self.sim_clock,
            self.pausing,
            self.backlog,
            self.live,
            self.namesakes,
            *self.cutting,
            self.recorder,
            self.contacts,
            self.answers,
            *(one for one in self.presenters if isinstance(one, OrganPublisher)),
            *([self.respiration] if self.respiration is not None else []),
            outlet,
            self.unexpected_errors,
        ]
        self.contacts.rate = self.parameters["contact_rate"]
        self.contacts.start()
        if self.parameters["record"]:
            self.get_logger().info(f"recording to {self._start_recording()}")
        outlet.start()
        self._warn_of_fine_tools()
        simulations = self.scene.simulations
        substeps = max(int(max(one.settings.substeps, one.settings.least_substeps)) for one in simulations)
        self.get_logger().info(
            f"{described(self.scene.names, self.scene.organs)}; model {simulations[0].variant}, {simulations[0].rate:g}"
            f" Hz, {substeps} substeps; tools: {', '.join(self.parameters.tools)}; {describe_discovery()}"
        )

        self._ready.publish(Bool(data=True))

    def _warn_of_fine_tools(self) -> None:
        """Warn about tools that are finer than the coarsest organ's surface resolves, and say what helps."""
        coarsest = max(self.scene.organs, key=mean_edge)
        for tool in (tool_of(self.parameters, name) for name in self.parameters.tools):
            why = unresolved_tools_of(coarsest, tool.radius) if tool.is_round else None
            if why is not None:
                self.get_logger().warning(f"tool '{tool.name}': {why}")

    def close(self) -> None:
        """End with zero forces, close the bag, delete the markers, end the threads; in well under a second."""
        self.pausing.close()
        noted = self.unexpected_errors.noted  # where one of them fails, the others are still done
        if self._outlet is not None:
            self._outlet.stop()
        self.answers.stop()
        for port in self.ports:
            with noted():
                port.output.publish_zero()
        with noted():
            self._ready.publish(Bool(data=False))
        for presenter in (*self.presenters, self.tool_presenter):
            with noted():
                presenter.close()
        self.contacts.stop()
        for cutting in self.cutting:
            cutting.close()
        with noted():
            self._close_bag()
        self.loop.stop()

    def _close_bag(self) -> None:
        path = self.recorder.stop(BAG_PATIENCE)
        if path is not None and self.recorder.error:
            self.get_logger().error(self.recorder.error)
        elif path is not None and not self.recorder.kept:
            self.get_logger().warning(NOT_KEPT)
        elif path is not None:
            lost = f", without {self.recorder.lost} messages" if self.recorder.lost else ""
            self.get_logger().info(f"bag closed: {path}{lost}")

    def _prefer(self, priority: int) -> None:
        """Give the loop the highest priority, and one below it to the answering and to the calling thread."""
        try:
            self.loop.prefer(priority)
            self.answers.prefer(below(priority))
            prefer(below(priority))
        except OSError as error:
            self.get_logger().warning(
                f"realtime_priority {priority} is refused ({error.strerror}): the loop runs without a real-time"
                " priority; allow it with a line like '@haptics - rtprio 99' in /etc/security/limits.conf, and log"
                " in again"
            )

    # wiring ------------------------------------------------------------------------------------
    def _port(self, index: int, name: str, tools: ToolSet) -> ToolPort:
        values = self.parameters
        topics, frames = topics_of(values, name), frames_of(values, name, self._lookup)
        tool = ServedTool(index, name, tools, topics, frames, self.frame_id)
        other = "false" if topics.reliable else "true"
        for topic in filter(None, topics.names.values()):
            self.remedies[self.resolve_topic_name(topic)] = f"set {name}.reliable:={other}, or another QoS there"
        port = ToolPort(self.shared, tool, self._woken)
        port.output.device = DevicePort(
            port.pose_freshness,
            values[f"{name}.motion_scale"],
            values[f"{name}.passivity_damping"],
            self.organs.settings,
        )
        if frame_id := values[f"{name}.tf_frame"]:
            FollowedFrame(self, self._lookup, frame_id, port.input, 1.0 / values["rate"])
        return port

    def _cutting(self) -> list[OrganCutting]:
        """Return what cuts each organ: those of cells that move as a whole."""
        values, recorders = self.parameters, self.recorder.of_organ
        parts = CuttingParts(self.loop, self.scene.joined, self.contacts, recorders, self.live, self.frame_id)
        return [
            OrganCutting(
                self, one, number, parts, lambda: frames_of_node(values, self._lookup), lambda: values["cut_depth"]
            )
            for number, one in enumerate(self.served)
        ]

    def _finder(self, organ: Organ, tools: ToolSet) -> ContactFinder:
        return ContactFinder(organ, tools)

    def _config(self) -> JsonObject:
        scene = self.scene
        organs = [{"name": organ.name, "digest": organ.digest()} for organ in scene.organs]
        of_scene = {"scene": scene.title, "organs": dict(zip(scene.names, organs, strict=True))}
        return {
            "format": bag.FORMAT,
            "package_version": __version__,
            "node": self.get_fully_qualified_name(),
            "parameters": self.parameters.values(),
            "shape_gravity": scene.simulations[0].model.shape_gravity.tolist(),
            "tools": self.parameters.tools,
        } | (of_scene if scene.is_scene else {"organ": organs[0]})

    # services and parameters -------------------------------------------------------------------
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.loop.reset()
        response.success = True
        response.message = NEXT_TICK if self.pausing.paused else "the organ was reset to rest"
        return response

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                response.success, response.message = True, str(self._start_recording())
            else:
                path = self.recorder.stop()
                error = self.recorder.error or ("" if self.recorder.kept else NOT_KEPT)
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
        return self.recorder.start(folder, newest, split)

    def _post_settings(self, organ: int, settings: Settings) -> None:
        with self.recorder.lock:
            self.recorder.of_organ[organ].settings(self.organs.each[organ].post_settings(settings), settings)

    def _place_frames(self) -> None:
        """Publish on tf and to bags where the organ is."""
        if self._broadcast is not None:
            placed = placed_frames(self.parameters, self.parameters.tools)
            self._broadcast.fix(self.get_clock().now().nanoseconds, placed)
        self.recorder.organ_pose(self.parameters["organ_pose"])

    def _register(self) -> None:
        """Transform poses and wrenches to and from where the organ is now."""
        for port in self.ports:
            port.renew_frames(frames_of(self.parameters, port.name, self._lookup))
        self._place_frames()
        self._registrations += 1

    def _on_parameters(self, names: set[str]) -> None:
        if "organ_pose" in names:
            self._register()
        self.contacts.rate = self.parameters["contact_rate"]
        for port in self.ports:
            port.output.device.most = self.parameters[f"{port.name}.passivity_damping"]
        self.live.update()

    def _report(self) -> None:
        if self.parameters["coupling_stiffness"] > 0.0:
            self.live.update()  # poses may come at another rate now
        report = Report()
        report.values["registrations"] = self._registrations
        for part in self._parts:
            part.report(report)
        self.diagnostics.publish(report)
