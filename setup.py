"""Builds the C kernel, and the functions of the C library that races use."""

import sys

import numpy
from setuptools import Extension, setup

_IS_LINUX = sys.platform == "linux"
_PARTS = (
    "module",
    "action_reader",
    "arguments",
    "car_controller",
    "event_counter",
    "game_stepper",
    "kart_observer",
    "mlp",
    "racing_observer",
    "road_tracer",
    "rows",
    "step_scorer",
    "track_graph",
    *(["libm"] if _IS_LINUX else []),
)

if sys.platform == "win32":
    _FLAGS, _LIBRARIES = [], []
else:
    # Rounding must match numpy; errno and floating-point exceptions are unused.
    _FLAGS = ["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
    _LIBRARIES = ["m"]

_KERNEL = Extension(
    "stkzoo.kernel._kernel",
    sources=[f"stkzoo/kernel/{part}.c" for part in _PARTS],
    depends=[f"stkzoo/kernel/{part}.h" for part in ("arguments", "geometry", "kernel", "vectors")],
    include_dirs=[numpy.get_include()],
    # Hidden functions: the kernel then calls its own libm, not that of the system.
    extra_compile_args=[*_FLAGS, "-fvisibility=hidden"] if _FLAGS else [],
    libraries=_LIBRARIES,
)
_PLANNING = Extension(
    "stkzoo.agents.planning._planning",
    sources=[
        *(f"agents/planning/{part}.c" for part in ("module", "memory", "viewer", "weigher")),
        "stkzoo/kernel/arguments.c",
    ],
    depends=[
        "agents/planning/planning.h",
        *(f"stkzoo/kernel/{part}.h" for part in ("arguments", "geometry", "kernel", "vectors")),
    ],
    include_dirs=[numpy.get_include(), "stkzoo/kernel"],
    extra_compile_args=[*_FLAGS, "-fvisibility=hidden"] if _FLAGS else [],
    libraries=_LIBRARIES,
)
# Not a Python module: the dynamic linker loads it into engine processes.
_LIBM = Extension(
    "stkzoo.engine._libm",
    sources=["stkzoo/kernel/libm.c"],
    extra_compile_args=_FLAGS,
    libraries=_LIBRARIES,
)

setup(ext_modules=[_KERNEL, _PLANNING, *([_LIBM] if _IS_LINUX else [])])
