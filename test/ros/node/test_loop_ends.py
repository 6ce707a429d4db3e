"""A loop that ends while the node runs. In a file of its own, as two nodes of a name would both be asked."""

import re

from std_srvs.srv import Trigger

from helpers.patience import LIMIT
from helpers.ros.processes import press_until_contact, start_sabotaged
from tissue_sim.ros.bags import recovery
from tissue_sim.ros.bags.recording import Recording


def test_a_node_whose_loop_ends_zeroes_its_wrenches_closes_the_bag_and_says_where(tmp_path, client):
    process = start_sabotaged(tmp_path, "record:=true", f"record_folder:={tmp_path / 'bags'}")

    def move(position):
        client.send_pose(position)
        client.spin(0.005)

    where = press_until_contact(client, move)
    (bag,) = (tmp_path / "bags").iterdir()

    def has_state():
        move(where)
        return any(one.topic.endswith("/state") for one, *_ in recovery.messages(bag))

    assert client.spin_until(has_state)
    sabotage_loop = client.node.create_client(Trigger, "/tissue_sim/end_loop")
    assert sabotage_loop.wait_for_service(LIMIT)
    sabotage_loop.call_async(Trigger.Request())
    assert client.spin_until(lambda: client.hand_force() == 0.0)
    assert process.wait() == 1
    client.spin(0.2)
    assert client.hand_force() == 0.0
    text = process.text()
    ends = [line for line in text.splitlines() if line.startswith("tissue_node: error: ")]
    assert len(ends) == 1
    assert re.search(r"internal: the physics loop ended: ZeroDivisionError: .* \(tissue_sim/\S+:\d+\)", ends[0])
    assert "Traceback" not in text
    assert "bag closed" in text
    assert len(Recording.read(bag).wrenches[0]) > 0
