"""Starts a daemon and kills the keeper."""

import os
import signal
import time


def get_actor(module_dir, observation_space, action_space):
    if not os.fork():
        os.setsid()
        if not os.fork():
            with open(os.environ["STKZOO_TEST_PIDS"], "a") as file:
                file.write(f"{os.getpid()} ")
            time.sleep(3600)
        os._exit(0)
    os.wait()
    time.sleep(0.1)
    os.kill(os.getppid(), signal.SIGKILL)
    return lambda state, observation: action_space.sample()
