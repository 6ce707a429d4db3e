"""A node that takes up every pose some ticks late: a fault that a benchmark of latency has to find.

DELAYED_TICKS in the environment: by how many.
"""

import itertools
import os
import threading
import time
from collections import deque

from tissue_sim.ros.node import program
from tissue_sim.ros.shared.organs import Organs

DELAY = int(os.environ["DELAYED_TICKS"])
post_poses = Organs.post_poses
waiting, numbers = deque(), itertools.count(1)


def post_late(organs, bodies, poses, stamp=0):
    waiting.append((organs.loop.ticks + DELAY, organs, bodies, poses.copy(), stamp))
    return next(numbers)


def take():
    while True:
        if waiting and waiting[0][1].loop.ticks >= waiting[0][0]:
            post_poses(*waiting.popleft()[1:])
        else:
            time.sleep(1e-4)


Organs.post_poses = post_late
threading.Thread(target=take, daemon=True).start()
program.run()
