"""Modules of a Rust crate form layers: no top-level module imports one that, by way of others, imports it."""

import re

import pytest
from conftest import ROOT

CRATES = sorted(path.parent for path in (ROOT / "rust").glob("*/src"))

#: What names no module: comments, raw strings, strings and characters.
TEXT = re.compile(
    r"""//[^\n]*|/\*.*?\*/|\br(#*)".*?"\1|"(?:\\.|[^"\\])*"|'(?:\\u\{\w+\}|\\.|[^'\\])'""", re.DOTALL
)
TEST_MODULE = re.compile(r"#\[cfg\(test\)\]\s*(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*([{;])")
#: The start of a path from the root of the crate or the module above: ``crate::a`` or ``crate::{a, b::c}``.
PATH = re.compile(r"\b(crate|super(?:\s*::\s*super)*)\s*::\s*(\{|r?#?\w+|\$)")
REEXPORT = re.compile(r"\buse\s+(?:self::|crate::)?(\w+)\s*::([^;]+);")


def closing_brace(text, opening):
    """Where the brace at ``opening`` is closed."""
    depth = 0
    for at in range(opening, len(text)):
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth == 0:
            return at
    raise ValueError("a brace is never closed")


def first_names(group):
    """The first name of every path in a list such as ``a, b::{c, d}``."""
    while "{" in group:
        opening = group.index("{")
        group = group[:opening] + group[closing_brace(group, opening) + 1 :]
    return [part.split("::")[0].split(" as ")[0].strip() for part in group.split(",") if part.strip()]


def without_tests(path, text):
    """The code of a file without its test modules, and the files that are test modules of it."""
    text = TEXT.sub("", text)
    folder = path.parent if path.name in ("lib.rs", "main.rs", "mod.rs") else path.with_suffix("")
    files = []
    while match := TEST_MODULE.search(text):
        end = match.end()
        if match[2] == "{":
            end = closing_brace(text, match.end() - 1) + 1
        else:
            files += [folder / f"{match[1]}.rs", folder / match[1] / "mod.rs"]
        text = text[: match.start()] + text[end:]
    return text, files


def sources(crate):
    """The text of every file of a crate that is not a test."""
    texts, tests = {}, set()
    for path in sorted((crate / "src").rglob("*.rs")):
        texts[path], of_tests = without_tests(path, path.read_text(encoding="utf-8"))
        tests.update(of_tests)
    return {path: text for path, text in texts.items() if path not in tests}


def depth(source, path):
    """How many modules deep a file is in its crate; 0 for the root."""
    parts = path.relative_to(source).with_suffix("").parts
    return 0 if parts in (("lib",), ("main",)) else len(parts) - (parts[-1] == "mod")


def imports(crate):
    """For every top-level module of a crate, the others that it imports, and a file that does."""
    source = crate / "src"
    files = sources(crate)
    modules = {}
    for path in files:
        if depth(source, path):
            modules.setdefault(path.relative_to(source).parts[0].removesuffix(".rs"), {})
    # What the root shows under its own name belongs to the module that it comes from.
    origin = {name: name for name in modules}
    for path, text in files.items():
        if depth(source, path) == 0:
            for module, rest in REEXPORT.findall(text):
                if module in modules:
                    origin.update({name: module for name in re.findall(r"\w+", rest) if name not in modules})
    for path, text in files.items():
        if depth(source, path) == 0:
            continue
        module = path.relative_to(source).parts[0].removesuffix(".rs")
        for match in PATH.finditer(text):
            if match[1] != "crate" and match[1].count("super") < depth(source, path):
                continue
            if match[2] == "{":
                names = first_names(text[match.end() : closing_brace(text, match.end() - 1)])
            elif match[2] == "$":
                # A macro imports what it is called with: any module that the file names.
                names = re.findall(r"\b(\w+)\s*::", text)
            else:
                names = [match[2].removeprefix("r#")]
            for name in names:
                imported = origin.get(name)
                if imported not in (None, module):
                    modules[module].setdefault(imported, path.relative_to(source).as_posix())
    return modules


def circle(modules):
    """A list of modules each of which imports the next, and the last the first; empty if there is none."""
    done = set()

    def search(module, way):
        if module in way:
            return way[way.index(module) :]
        if module in done:
            return []
        for imported in sorted(modules[module]):
            if found := search(imported, [*way, module]):
                return found
        done.add(module)
        return []

    return next((found for module in sorted(modules) if (found := search(module, []))), [])


def described(modules, found):
    steps = zip(found, [*found[1:], *found[:1]], strict=True)
    return "; ".join(f"{module} imports {other} ({modules[module][other]})" for module, other in steps)


@pytest.mark.parametrize("crate", CRATES, ids=lambda crate: crate.name)
def test_modules_form_layers(crate):
    modules = imports(crate)
    found = circle(modules)
    assert not found, described(modules, found)


def write_crate(folder, **files):
    for name, text in files.items():
        path = folder / "src" / f"{name.replace('__', '/')}.rs"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "files",
    [
        {"a": "use crate::b::B;", "b": "pub struct B(crate::a::A);"},
        {"a": "use crate::{c::{D, E}, b};", "b": "use super::a;", "c": ""},
        {"a__mod": "", "a__deep": "use super::super::b;", "b": "use crate::Shown;"},
        {"a": "use crate::b::B;", "b": "use crate::c::C;", "c": "use crate::a::A;"},
        {"a": "list! { $(use crate::$module::$name;)+ }\nlist! { b::B, }", "b": "use crate::a::A;"},
    ],
    ids=["pair", "list", "shown by the root", "three", "macro"],
)
def test_a_circle_is_found(tmp_path, files):
    crate = write_crate(tmp_path, lib="mod a; mod b; pub use a::{Other, Shown};", **files)
    assert circle(imports(crate))


def test_comments_tests_and_one_way_are_no_circle(tmp_path):
    crate = write_crate(
        tmp_path,
        lib="mod a; mod b; pub use a::A;",
        a="//! See [`crate::b`].\n#[cfg(test)]\nmod tests {\n    use crate::b::B;\n}\n",
        b="use crate::A;\n#[cfg(test)]\nmod checks;\n",
        b__checks="use crate::c;",
        c="use crate::b;",
    )
    modules = imports(crate)
    assert modules == {"a": {}, "b": {"a": "b.rs"}, "c": {"b": "c.rs"}}
    assert not circle(modules)
