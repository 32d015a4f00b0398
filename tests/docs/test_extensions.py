"""The site's Sphinx extensions."""

import importlib.util

import pytest

from tests.support.paths import ROOT


def extension(name):
    path = ROOT / "docs" / "_extensions" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def site(tmp_path):
    (tmp_path / "index.html").write_text(
        '<h1 id="top"></h1><a href="other.html#here">1</a> <a href="#top">2</a>'
        '<a href="https://example.org/gone">3</a> <img src="picture.png">'
    )
    (tmp_path / "other.html").write_text('<p id="here"></p><a href="index.html">back</a>')
    (tmp_path / "picture.png").write_bytes(b"")
    return tmp_path


def test_a_correct_site_has_no_broken_links(site):
    assert extension("internal_links").broken_links(site) == []


@pytest.mark.parametrize(
    ("link", "complaint"),
    [
        ('<a href="none.html">', "none.html: no such file"),
        ('<a href="other.html#there">', "other.html#there: no such place on the page"),
        ('<img src="none.png">', "none.png: no such file"),
        ('<a href="#bottom">', "#bottom: no such place on the page"),
    ],
)
def test_broken_links_are_found(site, link, complaint):
    with (site / "index.html").open("a") as page:
        page.write(link)
    assert extension("internal_links").broken_links(site) == [f"index.html: {complaint}"]


def test_links_to_published_files_become_links_within_the_site():
    inside = extension("outside_links").inside
    folder = ROOT / "docs" / "how-to"
    method = "../explanation/benchmarks.md"
    assert inside("[method](../../benchmarks/README.md)", folder) == f"[method]({method})"
    assert inside("[results](../../benchmarks/results)", folder) == "results"
    assert inside("[tracks](../../stkzoo/tracks.py)", folder) == "[tracks](../../stkzoo/tracks.py)"
    log = inside("[log](../../benchmarks/results/research-log.md#scout)", folder)
    assert log.endswith("/blob/main/benchmarks/results/research-log.md#scout)")
    assert inside("[agents](../reference/agents.md)", folder) == "[agents](../reference/agents.md)"


def test_files_and_the_pages_that_replace_them_exist():
    for file, page in extension("outside_links").PAGES.items():
        assert file.exists()
        assert page.exists()
