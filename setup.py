"""Builds the C kernel, which is optional: if it cannot be built, the installation continues."""

import sys

import numpy
from setuptools import Extension, setup

_PARTS = (
    "module",
    "action_reader",
    "car_controller",
    "event_counter",
    "game_stepper",
    "kart_observer",
    "messages",
    "mlp",
    "plan_memory",
    "plan_viewer",
    "plan_weigher",
    "racing_observer",
    "road_tracer",
    "rows",
    "step_scorer",
    "track_graph",
)

setup(
    ext_modules=[
        Extension(
            "stkzoo.kernel._kernel",
            sources=[f"stkzoo/kernel/{part}.c" for part in _PARTS],
            depends=[
                f"stkzoo/kernel/{part}.h"
                for part in ("geometry", "kernel", "plan_memory", "vectors")
            ],
            include_dirs=[numpy.get_include()],
            # Rounding must match numpy; errno and floating-point exceptions are unused.
            extra_compile_args=[]
            if sys.platform == "win32"
            else ["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"],
            optional=True,
        )
    ]
)
