"""Floods the live page and the race server at full scale.

    python -m benchmarks.floods

Each attack hits a race or a server that may open 1024 file descriptors (ulimit -n 1024). For each
attack, the command prints the maximum number of descriptors and the maximum memory, whether the
page or the server answered during the attack, whether the race's result, replay and video are
complete, and whether the next race was served. It returns 1 if any of these checks fails.
"""

from __future__ import annotations

import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo._arguments import CommandParser
from stkzoo.race import RaceResult
from stkzoo.race.replay import load_replay
from tests.fuzz.messages import resident_memory
from tests.support import floods

_STEPS = 150
_FILES = ("race.json", "race.stkz", "race.mp4")


@dataclass
class Outcome:
    """Outcome of an attack.

    Attributes:
        descriptors: maximum number of open file descriptors.
        memory: maximum resident memory [bytes].
        answered: whether the victim answered during the attack.
        kept: whether the result is complete.
        next_served: whether the next race was served.
        log_lines: lines on stderr.
    """

    descriptors: int = 0
    memory: int = 0
    answered: bool = True
    kept: bool = True
    next_served: bool = True
    log_lines: int = 0

    @contextmanager
    def watching(self, process: subprocess.Popen[str]) -> Iterator[None]:
        """Records the maximum descriptors and memory of a process."""
        done = threading.Event()

        def watch() -> None:
            while not done.wait(0.05):
                with suppress(OSError, IndexError, ValueError):
                    self.descriptors = max(self.descriptors, floods.num_descriptors(process.pid))
                    self.memory = max(self.memory, resident_memory(process.pid))

        thread = threading.Thread(target=watch)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


Attack = Callable[[tuple[str, int]], list[Any]]


def attack_page(attack: Attack, descriptors: int) -> Outcome:
    """Attacks the page of a race that writes all of its outputs."""
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, name) for name in _FILES]
        words = ["heuristic", "ai", "--track", "lighthouse", "--seed", "1", "--hide"]
        words += ["--render-backend", "map", "--max-steps", str(_STEPS), "--output", str(files[0])]
        words += ["--replay", str(files[1]), "--video", str(files[2])]
        with floods.race_with_page(*words, descriptors=descriptors) as (race, url):
            port = int(url.rsplit(":", 1)[1].strip("/"))
            lines: list[str] = []
            reader = threading.Thread(target=lambda: lines.extend(race.stderr or ()))
            reader.start()
            with outcome.watching(race):
                held = attack(("127.0.0.1", port))
                outcome.answered = floods.page_answers(url) is not None
                race.wait(120)
            reader.join()
        outcome.log_lines = len(lines)
        outcome.kept = race.returncode == 0 and _is_whole(*files)
        with floods.race_with_page(
            "heuristic", "--max-steps", "20", "--track", "lighthouse", port=port
        ) as (race, url):
            outcome.next_served = floods.page_answers(url) is not None and race.wait(60) == 0
        for one in held:
            one.close()
    return outcome


def _is_whole(result: Path, replay: Path, video: Path) -> bool:
    try:
        steps = RaceResult.from_json(result.read_text()).steps
        return steps == load_replay(replay).steps == _STEPS and video.stat().st_size > 1000
    except Exception as error:  # noqa: BLE001 - any error means a lost result
        print(f"lost: {error!r:.200}")
        return False


def attack_server(attack: Callable[[str], Any], descriptors: int) -> Outcome:
    """Attacks a server, with a race during the attack and one after it."""
    outcome = Outcome()
    with floods.limited_server("heuristic", descriptors=descriptors, stderr=subprocess.PIPE) as (
        server,
        address,
    ):
        with outcome.watching(server):
            held = attack(address)
            outcome.answered = _is_served(address)
            close = getattr(held, "close", None)
            if close is not None:
                close()
            outcome.next_served = _is_served(address)
        server.terminate()
        outcome.kept = server.wait(60) == 0
        assert server.stderr is not None  # noqa: S101 - a pipe
        outcome.log_lines = len(server.stderr.readlines())
    return outcome


def _is_served(address: str) -> bool:
    try:
        return not floods.remote_race(address)
    except Exception as error:  # noqa: BLE001 - any error means that no race was served
        print(f"not served: {error!r:.200}")
        return False


def _half_requests(count: int) -> Attack:
    def attack(address: tuple[str, int]) -> list[Any]:
        held: list[Any] = []
        floods.connect_all(address, count, floods.HALF_REQUEST, held)
        return held

    return attack


def _page_resets(count: int) -> Attack:
    def attack(address: tuple[str, int]) -> list[Any]:
        resetting = threading.Thread(target=floods.reset_at_once, args=(address, count))
        resetting.start()
        time.sleep(1.0)  # the page is requested during the resets
        return []

    return attack


def _idle(count: int) -> Callable[[str], Any]:
    def attack(address: str) -> Any:
        clients = floods.IdleClients(address, count)
        heard = clients.hear(3.0)
        print(f"  the clients heard {dict(heard.most_common(4))}")
        return clients

    return attack


def _server_resets(count: int) -> Callable[[str], None]:
    def attack(address: str) -> None:
        host, port = address.removeprefix("tcp://").rsplit(":", 1)
        floods.reset_at_once((host, int(port)), count)

    return attack


def _endless_message(address: str) -> None:
    with floods.zmtp_socket(address) as one:
        floods.send_until_closed(one, floods.zmtp_frame(bytes(1 << 20), more=True), 20.0)


def _heartbeats(address: str) -> None:
    with floods.zmtp_socket(address) as one:
        floods.send_until_closed(one, floods.PING * 1000, 10.0)


def main() -> int:
    """Runs the attacks and prints a line for each."""
    parser = CommandParser(prog="python -m benchmarks.floods", description=__doc__)
    parser.add_argument("--requests", type=int, default=5000, help="half-open requests")
    parser.add_argument("--clients", type=int, default=1200, help="idle clients")
    parser.add_argument("--resets", type=int, default=10_000, help="connections that are reset")
    parser.add_argument("--descriptors", type=int, default=1024, help="ulimit -n of the victims")
    arguments = parser.parse_args()
    floods.allow_descriptors(arguments.requests + 3 * arguments.clients + 500)
    attacks: dict[str, tuple[Callable[..., Outcome], Any]] = {
        f"page, {arguments.requests} half requests": (
            attack_page,
            _half_requests(arguments.requests),
        ),
        f"page, {arguments.resets} resets": (attack_page, _page_resets(arguments.resets)),
        f"server, {arguments.clients} idle clients": (attack_server, _idle(arguments.clients)),
        f"server, {arguments.resets} resets": (attack_server, _server_resets(arguments.resets)),
        "server, a message without end": (attack_server, _endless_message),
        "server, heartbeats without end": (attack_server, _heartbeats),
    }
    is_good = True
    for name, (run, attack) in attacks.items():
        begin = time.monotonic()
        outcome = run(attack, arguments.descriptors)
        is_good &= outcome.answered and outcome.kept and outcome.next_served
        print(
            f"{name:36} {outcome.descriptors:5d} descriptors, {outcome.memory / 1e6:6.0f} MB, "
            f"{outcome.log_lines:3d} log lines; answered {_word(outcome.answered)}, "
            f"nothing lost {_word(outcome.kept)}, next race {_word(outcome.next_served)} "
            f"({time.monotonic() - begin:.0f} s)",
            flush=True,
        )
    return 0 if is_good else 1


def _word(is_so: bool) -> str:
    return "yes" if is_so else "NO"


if __name__ == "__main__":
    raise SystemExit(main())
