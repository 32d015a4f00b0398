"""Typical mistakes of new users: the first line of each message has the cause and the remedy."""

import json
import socket
import sys
import zipfile

import gymnasium
import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.cli import main
from stkzoo.errors import MAX_LINE, StkzooError
from stkzoo.race import run_race

#: Command line, and a part of the first line of its message. ``{here}`` is a folder of examples.
COMMANDS = [
    ("rcae", "Did you mean 'race'?"),
    ("race", "no drivers; name some"),
    ("race heuristik", "Did you mean 'heuristic'?"),
    ("race ai --trak lighthouse", "Did you mean '--track'?"),
    ("race ai --track moon", "unknown track 'moon'. Choose a name from the list:"),
    ("race ai --laps two", "argument --laps: invalid int value: 'two'"),
    ("race ai ai --num-karts 1", "--num-karts is 1, but 2 drivers are named"),
    ("race ai --action-timeout -1", "action_timeout is -1.0, expected a number of seconds above 0"),
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
    ("keys show none.secret", "the key none.secret cannot be read (No such file or directory)"),
    ("race-server ai --secret open.secret", "first: chmod 600 open.secret"),
    ("race-server ai --secret text.zip", "has an invalid line, expected 'public' or 'secret'"),
    ("race-server random --address 127.0.0.1:{port}", "choose another address, or end the program"),
    ("race-server random --address *:5555", "give the server a key of its own (--secret)"),
    ("race-server ai", "name it on the client"),
    ("race-client", "no servers; give --server ADDRESS or --servers FILE"),
    ("race-client --servers none.txt", "the list of servers none.txt cannot be read"),
    ("race-client --server 127.0.0.1:1 --connect-timeout 0.1", "start it, or check its address"),
    ("race ai --web --web-port {port}", "choose another port (0 takes a free one)"),
    ("race ai:4", "expected ai:0, ai:1, ai:2, ai:3"),
    ("race ai@:", "has no name after @:; write one or leave it out"),
    (
        "race {here}/args",
        "get_actor takes (); expected (module_dir, observation_space, action_space",
    ),
    ("race {here}/extra", "install it, or put it into the agent's folder"),
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
    ("benchmark ai --forms PXA", "race form 'PXA' is unknown; expected P for each kart"),
    ("benchmark --compare none", "expected the --output of `stkzoo benchmark`"),
    (
        "benchmark --compare none --track hacienda --seeds 7 --jobs 2 --sandbox off",
        "--compare runs no races; leave out --track, --seeds, --jobs, --sandbox",
    ),
    ("benchmark --compare rated", "choose the file or folder of a benchmark"),
    ("demos ai --output demos.csv", "expected a path that ends in .safetensors"),
    ("play --rate 7", "rate is 7, expected one of 10, 12, 15, 20, 30, 60"),
    ("league", "the following arguments are required: --output"),
    ("assets install --from none.tar.xz", "there is no file 'none.tar.xz'"),
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


#: A mistake in Python, and a part of the first line of its message.
CALLS = [
    (lambda: make(num_kart=0), "num_kart is 0, expected a whole number from 1 to 256"),
    (lambda: make(num_kart="3"), "num_kart is '3', expected a whole number"),
    (lambda: make(num_kart=2, num_karts=2), "give one of them"),
    (lambda: make(num_agents=2), "unexpected keyword argument 'num_agents'"),
    (lambda: make(track=3), "track is 3, expected a name, names or None"),
    (lambda: make(view="simpel"), "Did you mean 'simple'?"),
    (lambda: make(view=("simple", {"state_itms": 3})), "Did you mean 'state_items'?"),
    (lambda: make(reward="racee"), "Did you mean 'race'?"),
    (lambda: make(reward={"progres": 1.0}), "unknown reward term 'progres'. Known: advance"),
    (lambda: make(opponents="heuristik"), "expected a list such as ['pretrained:ace', 'ai:3']"),
    (lambda: make(agents=5, num_kart=3), "raise num_kart or drop agents"),
    (lambda: make(agents=[{"nam": "Ada"}]), "Did you mean 'name'?"),
    (lambda: make(reverse="yes"), "reverse is 'yes', expected True, False or None"),
    (lambda: make().step({}), "reset"),
    (lambda: make().reset(seed=1.5), "seed is 1.5, expected a whole number of 0 or more"),
    (lambda: make().action_space("Kart_0"), "Did you mean 'kart_0'?"),
    (lambda: run_race(["none/agent.zip"]), "there is no agent 'none/agent.zip'; expected a folder"),
    (lambda: make().reset(options={"num_kart": 5}), "make another environment"),
    (lambda: make().reset(options="lighthouse"), "expected a dict from names of options"),
    (lambda: gymnasium.make("supertuxkart/simple-v0", trak="x"), "Did you mean 'track'?"),
    (lambda: stkzoo.make_stkrace_vec(1, env_kwarg={}), "Did you mean 'env_kwargs'?"),
    (lambda: stkzoo.register_view("my view", "simple"), "letters, digits and underscores"),
    (lambda: stkzoo.register_view("simple", "full"), "choose another name"),
    (lambda: stkzoo.RaceVectorEnv("two"), "num_races is 'two'"),
    (lambda: stkzoo.RaceVectorEnv(1, view="full"), "choose view="),
]


@pytest.mark.parametrize(("call", "expected"), CALLS, ids=[expected for _, expected in CALLS])
def test_a_mistake_in_python_is_explained(call, expected):
    with pytest.raises(StkzooError) as caught:
        call()
    assert expected in str(caught.value).splitlines()[0]
    assert is_legible(str(caught.value))


ACTIONS = [
    ({}, "kart_0"),
    ({"kart_0": 10**6}, "1000000"),
    ({"kart_0": np.zeros(2)}, "kart_0"),
    ({"kart_0": "left"}, "is 'left'; expected"),
    ({"kart_9": 0}, "no action for agent 'kart_0'; actions came for 'kart_9'"),
    ([0], "[0]"),
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
