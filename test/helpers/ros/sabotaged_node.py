"""A node that can be made to fail: it has services for that beside its own.

fail: the service itself raises; break_poses, break_answers, mend, break_parameters: what takes poses, answers them, or
takes parameters, does; fail_in_thread: a thread of its own does; hang, resume: the loop's thread stops where it is, and
goes on; end_loop: the compiled loop returns, and its thread ends with an error.
"""

import ctypes
import signal
import threading

from std_srvs.srv import Trigger

from tissue_sim.ros.node import program, serve
from tissue_sim.ros.node.node import TissueNode
from tissue_sim.ros.shared.loop import Loop

libc = ctypes.CDLL(None)
tick_on = Loop._tick_on


def failing(*_: object) -> None:
    raise ZeroDivisionError("sabotaged,\nin two lines")


def failing_loop(loop: Loop) -> None:
    tick_on(loop)
    if Sabotaged.loop_fails:
        failing()


class Sabotaged(TissueNode):
    loop_fails, hangs = False, False

    def start(self) -> None:
        super().start()
        libc.signal.argtypes = (ctypes.c_int, ctypes.c_void_p)
        # In C, as the loop holds no GIL: a signal has its thread wait for another signal, which does nothing.
        for number, handler in ((signal.SIGUSR1, libc.pause), (signal.SIGUSR2, libc.abs)):
            libc.signal(number, ctypes.cast(handler, ctypes.c_void_p))
        output, answer = self.ports[0].output, self.ports[0].output.answer
        organs, post_poses = self.organs, self.organs.post_poses
        services = {
            "fail": failing,
            "break_poses": lambda: setattr(organs, "post_poses", failing),
            "break_answers": lambda: setattr(output, "answer", failing),
            "mend": lambda: (setattr(organs, "post_poses", post_poses), setattr(output, "answer", answer)),
            "break_parameters": lambda: self.parameters.changed.append(failing),
            "fail_in_thread": lambda: threading.Thread(target=failing).start(),
            "hang": lambda: self.let_hang(True),
            "resume": lambda: self.let_hang(False),
            "end_loop": self.end_loop,
        }
        for name, act in services.items():
            self.create_service(Trigger, f"~/{name}", lambda _, response, act=act: self.done(act, response))

    @staticmethod
    def done(act: object, response: Trigger.Response) -> Trigger.Response:
        act()
        response.success = True
        return response

    def let_hang(self, hangs: bool) -> None:
        """Once, however often it is asked: a client asks again where the answer is late, and a second signal stays."""
        if hangs != self.hangs:
            self.hangs = hangs
            signal.pthread_kill(self.loop._thread.ident, signal.SIGUSR1 if hangs else signal.SIGUSR2)

    def end_loop(self) -> None:
        Sabotaged.loop_fails = True
        self.loop.words.control.stop = True


serve.TissueNode = Sabotaged
Loop._tick_on = failing_loop
program.run()
