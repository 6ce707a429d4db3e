"""A node in which a cut hurts: the tick that takes it up copies its state many times, and Python's lock is held before.

Both change nothing else.
"""

import ctypes

import numpy as np

from tissue_sim.model.cutting.carry import CarryPlan
from tissue_sim.ros.node import program
from tissue_sim.ros.shared import loop
from tissue_sim.ros.shared.loop import Loop

COPIES = 200  # each of some 50,000 words
HELD = 0.05  # s
exchange, boxes_after = Loop.exchange, loop.boxes_after


def often(before, state, plan):
    return boxes_after(before, state, CarryPlan(*(np.tile(words, COPIES) for words in plan)))


def held(*arguments, **named):
    ctypes.PyDLL(None).usleep(round(1e6 * HELD))
    return exchange(*arguments, **named)


loop.boxes_after, Loop.exchange = often, held
program.run()
