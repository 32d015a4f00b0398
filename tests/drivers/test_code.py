"""Loading an agent's code does not change the program's own modules."""

import sys
from contextlib import ExitStack

from stkzoo.drivers.driver import find_driver


def test_the_programs_modules_in_an_agents_folder_stay_loaded(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("value = 1\n")
    (tmp_path / "swift_helper.py").write_text("value = 2\n")
    (tmp_path / "swift.py").write_text(
        "import swift_helper\n\ndef get_actor(*_):\n    return lambda state, observation: None\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    import mine

    with ExitStack() as resources:
        code = find_driver("swift", inline=True).load(resources)
        with code.scope:
            assert sys.modules["swift_helper"].value == 2
            assert sys.modules["mine"] is mine
        assert sys.modules["mine"] is mine
        assert "swift_helper" not in sys.modules
    del sys.modules["mine"]
