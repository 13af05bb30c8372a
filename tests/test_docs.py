"""The README and the guide do what they say: links lead somewhere, blocks run, and print what they show.

In these pages, blocks marked ``console`` and ``python`` are run in the order of the page, in a directory in
which the README's tour was run before. A block without a language is what the one before it prints. ``cpp``
blocks are compiled. ``sh`` blocks are not run: they name files that a reader has, or take long.
"""

import os
import re
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest
from conftest import ROOT

README = ROOT / "README.md"
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]

NUMBER = re.compile(r"\d[\d,]*(?:\.\d*)?(?:e-?\d+)?")
# Another instruction set, whose rounding leads a fit elsewhere, changes errors by up to a tenth; and the last
# digit of errors as small as 9e-6 counts for less.
RELATIVE, ABSOLUTE = 0.2, 3e-6


def blocks(page):
    """(language, text) of every fenced block."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    assert all(text.strip() for _, text in found), f"{page}: an empty block"
    return found


def has_commands(page):
    return any(language in ("console", "python") for language, _ in blocks(page))


def links(page):
    return re.findall(r"\]\(([^)\s]+)\)", page.read_text())


def anchors(page):
    """What GitHub makes of headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        letters = [c for c in heading.lower() if c in " -_" or unicodedata.category(c)[0] in "LN"]
        yield "".join(letters).replace(" ", "-")


def assert_printed(expected, printed):
    """``expected`` may end lines early, and all of it at ``…``; numbers are those of some instruction set."""
    printed = printed.splitlines()
    for i, line in enumerate(expected.splitlines()):
        if line.strip() == "…":
            return
        assert i < len(printed), f"nothing is printed for {line!r}"
        ours, theirs = (NUMBER.sub("#", re.sub(r"\s+", " ", text)) for text in (line, printed[i]))
        assert theirs.startswith(ours.rstrip()), f"{printed[i]!r} is printed for {line!r}"
        for a, b in zip(NUMBER.findall(line), NUMBER.findall(printed[i])):
            a, b = float(a.replace(",", "")), float(b.replace(",", ""))
            assert abs(a - b) <= RELATIVE * abs(a) + ABSOLUTE, f"{printed[i]!r} is printed for {line!r}"
    assert len(printed) == len(expected.splitlines()), f"more is printed: {printed}"


def run(command, directory):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    result = subprocess.run(
        command, cwd=directory, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    assert result.returncode == 0, f"{command} in the documentation: {result.stderr}"
    return result.stdout


def run_page(page, directory):
    """Runs the blocks of a page; returns how many commands and programs there were."""
    count, printed = 0, None
    for language, text in blocks(page):
        if language == "console":
            for session in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                command, _, expected = session.partition("\n")
                printed = run(["bash", "-c", command], directory)
                if expected:
                    assert_printed(expected, printed)
                count += 1
        elif language == "python":
            printed = run([sys.executable, "-c", text], directory)
            count += 1
        elif not language:
            assert_printed(text, printed)
    return count


@pytest.fixture(scope="module")
def toured(tmp_path_factory):
    """A directory in which the README's tour was run, as in one where the demo was."""
    pytest.importorskip("glimt", reason="the package is not installed: pip install .")
    mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    mi.set_variant("llvm_ad_rgb")
    directory = tmp_path_factory.mktemp("tour")
    (directory / "out").mkdir()
    (directory / "scenes").symlink_to(ROOT / "scenes")
    assert run_page(README, directory) >= 8
    return directory


def test_tour_of_the_readme(toured):
    assert (toured / "out" / "orange.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", list(filter(has_commands, GUIDE)), ids=lambda page: page.stem)
def test_guide(page, toured):
    assert run_page(page, toured) > 0


def test_cpp_blocks_compile(tmp_path):
    programs = [text for page in [README, *GUIDE] for language, text in blocks(page) if language == "cpp"]
    assert programs
    compiler = os.environ.get("CXX", "c++").split()
    options = ["-std=c++17", "-Wall", "-Werror", "-fsyntax-only", f"-I{ROOT / 'cpp' / 'include'}"]
    for text in programs:
        (tmp_path / "block.cpp").write_text(text)
        run([*compiler, *options, "block.cpp"], tmp_path)


def test_readme_is_short():
    assert len(README.read_text().splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for link in links(page):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{page}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{page}: {link} is none of {list(anchors(target))}"


def test_index_has_every_page():
    index = ROOT / "docs" / "README.md"
    linked = {(index.parent / link).resolve() for link in links(index)}
    missing = set((ROOT / "docs").rglob("*.md")) - linked - {index}
    assert not missing
