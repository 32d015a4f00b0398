"""Typical mistakes of new users: the first line of each message has the cause and the remedy."""

import copy
import json
import pickle
import re
import socket
import subprocess
import sys
import zipfile
from contextlib import closing
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.cli import main
from stkzoo.errors import MAX_LINE, AgentException, ApiOrderError, ConfigError, StkzooError
from stkzoo.evaluation import run_tournament
from stkzoo.mdp.transition import Transition
from stkzoo.race import Driver, find_driver, run_race
from stkzoo.suite import find_task

#: Command line, and a part of the first line of its message. ``{here}`` is a folder of examples.
COMMANDS = [
    ("rcae", "Did you mean 'race'?"),
    ("race", "no drivers; name some"),
    ("race heuristik", "Did you mean 'heuristic'?"),
    ("race ai --trak lighthouse", "Did you mean '--track'?"),
    ("race ai --track moon", "unknown track 'moon'. Choose a name from the list:"),
    ("race tux", "unknown driver 'tux'. Choose a name from the list:"),
    ("race ACE", "Did you mean 'pretrained:ace'?"),
    ("suite list versos", "Did you mean 'versus'?"),
    ("race ai --laps two", "argument --laps: invalid int value: 'two'"),
    ("race ai ai --num-karts 1", "--num-karts is 1, but 2 drivers are named"),
    ("race ai --error-handling ignore", "invalid choice: 'ignore'"),
    ("race --demo ai", "leave out --demo or the drivers"),
    ("race ai --cameras 2", "--cameras does nothing without --video; give both"),
    ("race ai --replay a.stkz --races 2", "--races runs several races; leave out --replay"),
    ("race ai --output {here}", "it is not a regular file; choose another name"),
    ("race ai --output a.stkz --replay a.stkz", "give each a file of its own"),
    ("race {here}/empty", "pystk_actor.py"),
    ("race {here}/broken", "SyntaxError"),
    ("race {here}/no_view", "env_name"),
    ("race {here}/deep.zip", "pystk_actor.py"),
    ("check", "the following arguments are required: AGENT"),
    ("new {here}/empty/../classless", "is not empty; choose another folder"),
    ("keys new open --folder {here}", "open.secret"),
    ("keys new open/x", "expected letters, digits, _ . and -"),
    ("race-server ai --secret open.secret", "first: chmod 600 open.secret"),
    ("race-server ai --secret text.zip", "has an invalid line, expected 'public' or 'secret'"),
    ("race-server random --address 127.0.0.1:{port}", "choose another address, or end the program"),
    ("race-server random --address *:5555", "give the server a key of its own (--secret)"),
    ("race-server ai", "name it on the client"),
    ("race-client", "no servers; give --server ADDRESS or --servers FILE"),
    ("race-client --servers none.txt", "the list of servers none.txt cannot be read"),
    ("race-client --server 127.0.0.1:1 --connect-timeout 0.1", "start it, or check its address"),
    ("race ai --web --web-port {port}", "choose another port (0 takes a free one)"),
    ("race ai@:", "has no name after @:; write one or leave it out"),
    (
        "race {here}/args",
        "get_actor takes (); expected (module_dir, observation_space, action_space",
    ),
    ("race {here}/extra", "install it (not with pip's -e), or put it into the agent's folder"),
    (
        "tournament",
        "a tournament needs at least two agents, such as my_agent and ai; this one has 0",
    ),
    ("tournament ai random --output text.zip", "Not a directory; choose another --output"),
    ("tournament --resume none", "none/plan.json has no tournament plan"),
    ("tournament --resume measured", "choose the file or folder of a tournament"),
    ("tournament --resume x --output y", "not allowed with argument --resume"),
    (
        "tournament --resume x --races 100 --track hacienda --laps 3 --jobs 1 --show-output",
        "--resume keeps the arguments of its tournament; leave out --track, --races, --laps",
    ),
    ("report none", "none/plan.json has no tournament plan (No such file or directory)"),
    ("benchmark", "no agent; name one, such as heuristic"),
    ("benchmark --compare none", "expected the --output of `stkzoo benchmark`"),
    (
        "benchmark --compare none --track hacienda --seeds 7 --jobs 2 --sandbox off",
        "--compare runs no races; leave out --track, --seeds, --jobs, --sandbox",
    ),
    ("benchmark --compare rated", "choose the file or folder of a benchmark"),
    ("demos ai --output demos.csv", "expected a path that ends in .safetensors"),
    ("league", "the following arguments are required: --output"),
]


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("here")
    sources = {
        "empty": None,
        "classless": "x = 1\n",
        "args": "def get_actor(): pass\n",
        "extra": "import torchvisionx\ndef get_actor(*_): return lambda state, obs: obs\n",
        "broken": "def get_actor(:\n",
        "no_view": "env_name = 'simpel'\ndef get_actor(*_): return lambda state, obs: obs\n",
    }
    for name, source in sources.items():
        (folder / name).mkdir()
        if source:
            (folder / name / "pystk_actor.py").write_text(source)
    (folder / "text.zip").write_text("no zip")
    with zipfile.ZipFile(folder / "deep.zip", "w") as archive:
        archive.writestr("readme.txt", "")
    plans = {"rated": "tournament-plan", "measured": "benchmark-plan"}
    for name, kind in plans.items():
        (folder / name).mkdir()
        plan = json.dumps({"type": kind, "schema_version": 1})
        (folder / name / "plan.json").write_text(plan)
    (folder / "damaged").mkdir()
    (folder / "damaged" / "plan.json").write_text("{")
    assert main(["keys", "new", "open", "--folder", str(folder)]) == 0
    (folder / "open.secret").chmod(0o644)
    return folder


def is_legible(text):
    first = text.splitlines()[0]
    return len(first) <= MAX_LINE and "Traceback" not in text


@pytest.fixture(scope="module")
def port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        yield taken.getsockname()[1]


@pytest.mark.parametrize(("words", "expected"), COMMANDS, ids=[words for words, _ in COMMANDS])
def test_a_mistake_on_the_command_line_is_explained(
    words, expected, here, port, capsys, monkeypatch
):
    monkeypatch.chdir(here)
    monkeypatch.delenv("DISPLAY", raising=False)
    code = main(words.format(here=here, port=port).split())
    said = capsys.readouterr().err
    assert code in (1, 2, 3), said
    first = said.replace(str(here), "HERE").splitlines()[0]
    assert expected.format(here="HERE") in first
    assert is_legible(said.replace(str(here), "HERE"))


#: Command line, the missing library, and a part of the message.
EXTRAS = [
    ("race ai --video film.mp4", "imageio_ffmpeg", "videos need ffmpeg"),
    ("race ai --web", "aiohttp", "the live page needs aiohttp"),
    ("race-client --server 127.0.0.1:1", "zmq", "networked races need zmq"),
    ("tournament ai random --output new", "openskill", "ratings need openskill"),
]


@pytest.mark.parametrize(("words", "module", "expected"), EXTRAS, ids=[e[2] for e in EXTRAS])
def test_a_missing_library_is_explained(words, module, expected, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in [m for m in sys.modules if m.partition(".")[0] == module] + [module]:
        monkeypatch.setitem(sys.modules, name, None)
    assert main(words.split()) in (1, 2)
    first = capsys.readouterr().err.splitlines()[0]
    assert expected in first
    assert "pip install" in first


def test_missing_game_data_is_explained(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("SUPERTUXKART_DATADIR", str(tmp_path))
    assert main(["race", "ai"]) == 1
    said = capsys.readouterr().err.replace(str(tmp_path), "HERE")
    assert "Unset it and run `stkzoo assets install`" in said.splitlines()[0]
    assert is_legible(said)


#: The value that an agent returns, and a part of the race's report.
RETURNED = [
    ("None", "is None; expected a dict with the keys acceleration, brake"),
    ("{'steer': 0.0}", "lacks acceleration, brake"),
    ("{**space.sample(), 'steer': float('nan')}", "action['steer'] of agent 'kart_0' is nan"),
]


@pytest.mark.parametrize(("returned", "expected"), RETURNED, ids=[r for r, _ in RETURNED])
def test_an_invalid_action_of_an_agent_is_explained(returned, expected, tmp_path, capsys):
    source = f"""
env_name = "supertuxkart/simple-v0"
def get_actor(module_dir, observation_space, space):
    return lambda state, observation: {returned}
"""
    (tmp_path / "pystk_actor.py").write_text(source)
    assert main(["race", str(tmp_path), "--inline", "--track", "lighthouse"]) == 3
    (line,) = [text for text in capsys.readouterr().out.splitlines() if "failed at step 0" in text]
    assert expected in line


def make(**options):
    return race_v0.parallel_env(**options)


def start(**options):
    with make(num_kart=1, track="lighthouse", **options) as env:
        env.reset(seed=0)


#: A mistake in Python, and a part of the first line of its message.
CALLS = [
    (lambda: make(num_kart=0), "num_kart is 0, expected a whole number from 1 to 256"),
    (lambda: make(num_kart="3"), "num_kart is '3', expected a whole number"),
    (lambda: make(num_kart=2, num_karts=2), "give one of them"),
    (lambda: make(reverse="yes"), "reverse is 'yes', expected True, False or None"),
    (lambda: run_race(["none/agent.zip"]), "there is no agent 'none/agent.zip'; expected a folder"),
    (lambda: make().reset(options={"num_kart": 5}), "make another environment"),
    (lambda: make().reset(options="lighthouse"), "expected a dict from names of options"),
    (lambda: stkzoo.register_view("my view", "simple"), "letters, digits and underscores"),
    (lambda: stkzoo.RaceVectorEnv("two"), "num_races is 'two'"),
    (lambda: make(track="agents"), "unknown track 'agents'. Choose a name from the list:"),
    (lambda: make(track="LightHouse"), "Did you mean 'lighthouse'?"),
    (lambda: make(track=b"lighthouse"), "track is b'lighthouse', expected a name"),
    (lambda: make(view="supertuxkart/simple-v0"), "Did you mean 'simple'?"),
    (lambda: make(max_steps=3), "unexpected keyword argument 'max_steps'."),
    (lambda: make(agents=[{1: 2}]), "unknown field 1 of agent 0. Known: camera_mode"),
    (lambda: make(view=("simple", {1: 2})), "unknown option 1 of the simple view. Known:"),
    (lambda: make(view={5: "simple"}), "unknown agent 5. Known: kart_0, kart_1, kart_2."),
    (lambda: make(reward={5: "race"}), "unknown agent 5. Known: kart_0, kart_1, kart_2."),
    (lambda: make(reward={"kart_5": {"time": 1}}), "unknown agent 'kart_5'. Known: kart_0"),
    (lambda: make(reward={1.5: len, "mine": len}), "unknown agent 1.5. Known: kart_0"),
    (lambda: make(reward=len), "a dict of weights and functions such as {'time': 0.5"),
    (lambda: stkzoo.Reward({1: len}), "reward term 1 is <built-in function len>, expected a name"),
    (lambda: stkzoo.Reward([len]), "terms is [<built-in function len>], expected a dict by name"),
    (lambda: stkzoo.Reward({"mine": len}, 2.0), "weights is 2.0, expected a dict by name"),
    (lambda: start(start={5: 10.0}), "unknown agent 5. Known: kart_0."),
    (lambda: start(view=lambda _: None), "the view returned None; expected its environment"),
    (lambda: start(view=lambda _: gymnasium.make("CartPole-v1")), "wrap the one that it gets"),
    (lambda: make().reset(options={1: 2}), "unknown option 1. Choose a name from the list:"),
    (lambda: make().reset(options={"agents": 1}), "unknown option 'agents'. Choose a name"),
    (lambda: make().action_space(["kart_0"]), "unknown agent ['kart_0']. Did you mean 'kart_0'?"),
    (lambda: make().follow(None), "other is None, expected an environment of one race"),
    (lambda: setattr(make(), "options", {"laps": 2}), "{'laps': 2}, expected RaceOptions"),
    (lambda: stkzoo.make_stkrace_vec(1, env_kwargs=3), "env_kwargs is 3, expected a dict"),
    (lambda: find_driver(None), "a driver is None, expected a name such as 'ai' or a path"),
    (lambda: run_race([3]), "a driver is 3, expected a name such as 'ai' or a path"),
    (lambda: run_tournament(None, output="x"), "agents is None, expected a list"),
    (lambda: find_task("solo"), "unknown task 'solo'. Did you mean 'solo-general'?"),
    (lambda: stkzoo.MonoAgentWrapperAdapter(make(), {}).step({}), "step() before reset()"),
    (
        lambda: stkzoo.MonoAgentWrapperAdapter(gymnasium.make("supertuxkart/simple-v0"), {}),
        "expected an environment of several agents",
    ),
]


@pytest.mark.parametrize(("call", "expected"), CALLS, ids=[expected for _, expected in CALLS])
def test_a_mistake_in_python_is_explained(call, expected):
    with pytest.raises(StkzooError) as caught:
        call()
    assert expected in str(caught.value).splitlines()[0]
    assert is_legible(str(caught.value))


ACTIONS = [
    ({}, "kart_0"),
    ({"kart_9": 0}, "no action for agent 'kart_0'; actions came for 'kart_9'"),
    ({9: 0}, "no action for agent 'kart_0'; actions came for 9"),
    ({None: 0}, "no action for agent 'kart_0'; actions came for None"),
    ([0], "[0]; expected a dict with an action for each of 'kart_0'"),
    ({"kart_0": np.zeros((99, 99))}, "is an array of shape (99, 99) and dtype float64; expected"),
    ({"kart_0": print}, "is <built-in function print>; expected"),
]


@pytest.fixture(scope="module")
def race():
    with make(num_kart=1, track="lighthouse", view="flattened_discrete") as env:
        env.reset(seed=0)
        yield env


@pytest.mark.parametrize(("actions", "expected"), ACTIONS, ids=str)
def test_an_invalid_action_is_explained(race, actions, expected):
    with pytest.raises(StkzooError) as caught:
        race.step(actions)
    assert expected in str(caught.value).splitlines()[0]
    assert is_legible(str(caught.value))


@pytest.mark.parametrize("key", [0, "0", "kart_0", np.str_("kart_0")], ids=repr)
def test_an_agent_is_named_by_id_or_number(race, key):
    assert race.action_space(key) is race.action_spaces["kart_0"]
    observations, *_ = race.step({key: 0})
    assert list(observations) == ["kart_0"]


@pytest.mark.parametrize("key", [0, "0", "kart_0"], ids=repr)
def test_an_agent_of_the_gymnasium_id_is_named_by_id_or_number(key):
    options = {"num_kart": 1, "track": "lighthouse"}
    with gymnasium.make("supertuxkart/multi-full-v0", disable_env_checker=True, **options) as env:
        env.reset(seed=0)
        observations, *_ = env.step({key: env.action_space.sample()["0"]})
        assert list(observations) == ["0"]


class OnDevice:
    """An array of another library, which numpy cannot read."""

    shape = (2,)

    def __array__(self, *_, **__):
        raise RuntimeError("Use .get() to copy it")

    def __repr__(self):
        return "array on a device"


def tensors():
    torch = pytest.importorskip("torch", reason="extra sb3")
    return {
        "Use tensor.detach().numpy() instead": torch.zeros(2, requires_grad=True),
        "Use Tensor.to_dense() first": torch.zeros(2).to_sparse(),
        "convert meta device type tensor": torch.zeros(2, device="meta"),
        "Got unsupported ScalarType BFloat16": torch.zeros(2, dtype=torch.bfloat16),
        "copy it": OnDevice(),
    }


VIEW = "flattened_continuous_actions"


def parallel(action):
    with make(num_kart=1, track="lighthouse", view=VIEW) as env:
        env.reset(seed=0)
        env.step({"kart_0": action})


def in_turns(action):
    with closing(race_v0.env(num_kart=1, track="lighthouse", view=VIEW)) as env:
        env.reset(seed=0)
        env.step(action)


def single(action):
    with gymnasium.make(f"supertuxkart/{VIEW}-v0", num_kart=1, track="lighthouse") as env:
        env.reset(seed=0)
        env.step(action)


def batch(action):
    with closing(stkzoo.RaceVectorEnv(1, num_kart=1, track="lighthouse", view=VIEW)) as envs:
        envs.reset(seed=0)
        envs.step([action])


def policy(action):
    driver = Driver.of_policy(lambda _: action, view=VIEW)
    run_race([driver], track="lighthouse", max_steps=1, error_handling="raise")


@pytest.mark.parametrize("front", [parallel, in_turns, single, batch, policy])
def test_an_action_that_numpy_cannot_read_is_explained(front):
    for expected, action in tensors().items():
        with pytest.raises(StkzooError) as caught:
            front(action)
        assert expected in str(caught.value)
        assert "\n" not in str(caught.value)


#: What a reward term returns for a race of one kart, and a part of the message.
TERMS = [
    (None, "returned None, expected an array of shape (1,): a finite number for each kart"),
    ("good", "returned 'good', expected an array of shape (1,)"),
    (1.0, "returned 1.0, expected an array of shape (1,)"),
    ([1.0, 2.0], "returned [1.0, 2.0], expected an array of shape (1,)"),
    ([np.nan], "returned [nan], expected"),
    ({"kart_0": 1.0}, "returned {'kart_0': 1.0}, expected"),
    (np.zeros(1, complex), "returned array([0.+0.j]), expected"),
    (OnDevice(), "failed: RuntimeError: Use .get() to copy it"),
]


@pytest.mark.parametrize(("returned", "expected"), TERMS, ids=repr)
def test_what_a_reward_term_returns_is_checked(race, returned, expected):
    step = Transition(race.snapshot, race.snapshot, 100.0)
    with pytest.raises(ConfigError) as caught:
        stkzoo.Reward({"mine": lambda _: returned}).value("mine", step)
    assert expected in str(caught.value)
    assert is_legible(str(caught.value))


def test_a_race_with_a_failing_reward_term_stops_and_starts_again():
    with make(num_kart=1, track="lighthouse", reward={"mine": lambda _: None}) as env:
        for _ in range(2):
            with pytest.raises(ConfigError, match="reward term 'mine' returned None"):
                drive(env)


def drive(env):
    env.reset(seed=0)
    env.step({"kart_0": env.action_space("kart_0").sample()})


RESULTS = [
    ("reset", None, None, "they returned None, expected (observation, info)"),
    ("reset", 0, None, "they returned None as observation"),
    ("reset", 1, None, "they returned None as info"),
    ("step", None, None, "expected (observation, reward, terminated, truncated, info)"),
    ("step", None, (0, 1.0, False, {}), "expected (observation, reward, terminated, truncated"),
    ("step", 0, None, "they returned None as observation"),
    ("step", 1, None, "they returned None as reward"),
    ("step", 1, "good", "they returned 'good' as reward"),
    ("step", 1, np.nan, "they returned nan as reward"),
    ("step", 2, np.zeros(2), "they returned array([0., 0.]) as terminated"),
    ("step", 4, "info", "they returned 'info' as info"),
]


@pytest.mark.parametrize(("method", "part", "value", "expected"), RESULTS, ids=repr)
def test_what_a_wrapper_returns_is_checked(method, part, value, expected):
    def changed(self, *args, **options):
        result = getattr(self.env, method)(*args, **options)
        parts = (value if number == part else old for number, old in enumerate(result))
        return value if part is None else tuple(parts)

    view = type("Changed", (gymnasium.Wrapper,), {method: changed})
    with make(num_kart=1, track="lighthouse", view=view) as env:
        with pytest.raises(AgentException) as caught:
            drive(env)
        assert expected in str(caught.value)
        assert is_legible(str(caught.value))


def test_an_observation_outside_its_space_is_explained_in_a_vector_environment():
    class Broken(gymnasium.ObservationWrapper):
        def observation(self, _):
            return {"wrong": 1}

    def view(env):
        return Broken(stkzoo.views()["racing"](env))

    envs = stkzoo.RaceVectorEnv(1, num_kart=1, track="lighthouse", view=view)
    with pytest.raises(ConfigError, match=r"observation of slot 0 is \{'wrong': 1\}, which is not"):
        envs.reset(seed=0)
    envs.close()


COPIES = [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]


@pytest.mark.parametrize("duplicate", COPIES, ids=["copy", "deepcopy", "pickle"])
def test_a_copy_in_mid_race_names_clone(race, duplicate):
    with duplicate(race) as twin:
        for call in (lambda: twin.step({"kart_0": 0}), twin.state, twin.save_state):
            with pytest.raises(ApiOrderError, match=r"call reset\(\) first; .* only clone\(\)"):
                call()
        twin.reset(seed=0)
        twin.step({"kart_0": 0})


#: Arguments of training programs; the others need ``--output`` alone.
PROGRAMS = {
    "evaluate": "run",
    "export": "none.safetensors --name mine --output mine",
    "plot": "run",
    "ppo.selfplay": "--output new --total-timesteps 10",
    "rate": "run --output new",
}

WITHOUT_EXTRAS = """
import contextlib, io, json, runpy, sys
programs, missing = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(missing))
for name, words in programs.items():
    said = io.StringIO()
    sys.argv = [name, *words.split()]
    try:
        with contextlib.redirect_stderr(said):
            runpy.run_module("stkzoo.agents.training." + name, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        said.write(end.code if isinstance(end.code, str) else "")
    print(name, said.getvalue().strip().splitlines())
"""


def test_training_programs_without_their_extras_name_them(tmp_path):
    folder = Path(stkzoo.__file__).parent / "agents" / "training"
    names = [
        ".".join(file.relative_to(folder).with_suffix("").parts)
        for file in sorted(folder.rglob("*.py"))
        if "__main__" in file.read_text("utf-8")
    ]
    programs = {name: PROGRAMS.get(name, "--output new") for name in names}
    missing = ["matplotlib", "openskill", "ray", "stable_baselines3", "threadpoolctl"]
    arguments = json.dumps([programs, [*missing, "torch"]])
    command = [sys.executable, "-W", "ignore", "-c", WITHOUT_EXTRAS, arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    said = dict(line.split(" ", 1) for line in done.stdout.splitlines())
    assert list(said) == names
    for name, lines in said.items():
        needs_files_first = name in ("export", "plot")
        assert needs_files_first or re.fullmatch(r"\[.error: .* \(extra \w+\).*\]", lines), lines
