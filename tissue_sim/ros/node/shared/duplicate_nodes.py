"""Detection of other nodes of the same fully qualified name, whose topics and services would mix with ours."""

from __future__ import annotations

from rclpy.node import Node

from tissue_sim.ros.shared.report import Report


class DuplicateNodes:
    """Count of the nodes in the graph that have this one's name."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.count = 0

    def report(self, report: Report) -> None:
        """Add how many there are besides this one; log a line when there are more than before."""
        node = self._node
        own = (node.get_name(), node.get_namespace())
        count = max(0, node.get_node_names_and_namespaces().count(own) - 1)
        if count > self.count:
            node.get_logger().warning(
                f"another node has the name {node.get_fully_qualified_name()}, too: their topics and services"
                " interfere; start one of them with -r __node:=NAME or -r __ns:=/NAMESPACE"
            )
        self.count = count
        report.values["same_name_nodes"] = count
        if count:
            report.warnings.append(f"another node has the name {node.get_fully_qualified_name()}, too")
