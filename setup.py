"""Builds the C kernel, the planner's C, and the functions of the C library that races use."""

import os
import platform
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy
from setuptools import Extension, setup

#: Commands that compile. pip runs others before them, such as egg_info.
_COMPILING = {"build", "build_ext", "bdist_wheel", "editable_wheel", "install", "develop"}


def _check_compiler() -> None:
    """Ends the program with one sentence if it cannot compile; Linux only."""
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    include = sysconfig.get_path("include")
    words = [*compiler, "-fsyntax-only", f"-I{include}", "-x", "c", "-"]
    try:
        subprocess.run(  # noqa: S603 - the compiler that setuptools uses
            words, input=b"#include <Python.h>\n", capture_output=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        packages = "gcc libc6-dev"
        if not Path(include, "Python.h").exists():
            packages += f" python{sys.version_info.major}.{sys.version_info.minor}-dev"
        sys.exit(
            "stkzoo is partly written in C, so its installation needs a C compiler and Python's "
            f"headers: sudo apt install {packages} (Fedora: sudo dnf install gcc python3-devel)"
        )


if sys.platform == "linux" and _COMPILING & set(sys.argv):
    _check_compiler()

_IS_LINUX = sys.platform == "linux"
_LIBM_SOURCES = ["stkzoo/engine/libm.c"] if _IS_LINUX else []
_IS_X86 = platform.machine() == "x86_64"
_PARTS = (
    "module",
    "action_reader",
    "arguments",
    "car_controller",
    "event_counter",
    "game_stepper",
    "kart_observer",
    "racing_observer",
    "road_tracer",
    "rows",
    "step_scorer",
    "track_graph",
)

_PLANNING_PARTS = ("module", "memory", "network", "viewer", "weigher")

# Rounding must match numpy; errno and floating-point exceptions are unused.
_FLAGS = ["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
_LIBRARIES = ["m"]

_KERNEL = Extension(
    "stkzoo.kernel._kernel",
    sources=[*(f"stkzoo/kernel/{part}.c" for part in _PARTS), *_LIBM_SOURCES],
    depends=[f"stkzoo/kernel/{part}.h" for part in ("arguments", "geometry", "kernel")],
    include_dirs=[numpy.get_include()],
    # Hidden functions: the extensions then call their own libm, not that of the system.
    extra_compile_args=[*_FLAGS, "-fvisibility=hidden"],
    libraries=_LIBRARIES,
)
_PLANNING = Extension(
    "stkzoo.agents.planning._planning",
    sources=[
        *(f"agents/planning/{part}.c" for part in _PLANNING_PARTS),
        "stkzoo/kernel/arguments.c",
        *_LIBM_SOURCES,
    ],
    depends=[
        *(f"agents/planning/{part}.h" for part in ("planning", "vectors")),
        *(f"stkzoo/kernel/{part}.h" for part in ("arguments", "geometry", "kernel")),
    ],
    include_dirs=[numpy.get_include(), "stkzoo/kernel"],
    extra_compile_args=[*_FLAGS, "-fvisibility=hidden"],
    libraries=_LIBRARIES,
)
# Not Python modules: the dynamic linker loads them into engine processes.
_PRELOADED = [
    Extension(
        f"stkzoo.engine._{name}",
        sources=[f"stkzoo/engine/{name}.c"],
        extra_compile_args=_FLAGS,
        libraries=_LIBRARIES,
    )
    for name in ("libm", *["shortcuts"] * _IS_X86)
]


def _description() -> str:
    """Returns the README with absolute addresses, which a package index needs."""
    settings = Path("pyproject.toml").read_text("utf-8")
    (repository,) = re.findall(r'^Repository = "(.*?)"', settings, re.MULTILINE)
    (version,) = re.findall(r'^version = "(.*?)"', settings, re.MULTILINE)
    text = Path("README.md").read_text("utf-8")
    for before, kind in ((r'src="', "raw"), (r"!\[[^\]]*\]\(", "raw"), (r"\]\(", "blob")):
        text = re.sub(rf"({before})(?!https?:|#)", rf"\1{repository}/{kind}/v{version}/", text)
    return text


setup(
    ext_modules=[_KERNEL, _PLANNING, *(_PRELOADED if _IS_LINUX else [])],
    long_description=_description(),
    long_description_content_type="text/markdown",
)
