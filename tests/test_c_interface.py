"""The C and C++ interface: its promises, its examples, and every way in which it is compiled."""

import importlib.util
import os
import re
import shutil
import subprocess
import textwrap

import pytest
from conftest import ROOT
from model_libraries import LIBRARIES, write_library

INCLUDE = ROOT / "cpp" / "include"
EVALUATE = ROOT / "cpp" / "examples" / "evaluate.c"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return write_library(tmp_path_factory.mktemp("library") / "hybrid.safetensors", "hybrid")


def run(*command):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True)


def test_interface_keeps_its_promises(cpp_build, library):
    result = run(cpp_build / "interface", library, "metal")
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(("name", "is_surface"), [("maps", True), ("hybrid", False), ("factor", False)])
def test_places_keep_their_promises(cpp_build, name, is_surface, tmp_path):
    path = write_library(tmp_path / f"{name}.safetensors", **LIBRARIES[name])
    result = run(cpp_build / "surfaces", path, "metal", int(is_surface))
    assert result.returncode == 0, result.stderr


def test_example_in_cpp(cpp_build, library):
    result = run(cpp_build / "albedo", library)
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0] == "hybrid, 3 materials"
    assert len(lines) == 1 + 3 * 3
    albedo = [float(number) for number in lines[1].split(": ")[1].split()]
    # The red of the orange material, whose diffuse albedo is 0.55, 0.21, 0.04.
    assert 1 > albedo[0] > albedo[1] > albedo[2] > 0


def test_example_in_c(cpp_build, library):
    result = run(cpp_build / "evaluate", library, "orange")
    assert result.returncode == 0, result.stderr
    f = [float(number) for number in result.stdout.splitlines()[0].split()[1:]]
    assert len(f) == 3 and min(f) > 0
    result = run(cpp_build / "evaluate", library, "ornage")
    assert result.returncode == 1
    assert "did you mean orange?" in result.stderr
    assert run(cpp_build / "evaluate", library).returncode == 1
    assert run(cpp_build / "albedo", library.parent / "none").returncode == 1


@pytest.mark.parametrize(
    ("compiler", "flags", "header"),
    [
        ("cc", ["-x", "c", "-std=c99", "-pedantic"], "glimt.h"),
        ("cc", ["-x", "c", "-std=c17", "-pedantic"], "glimt.h"),
        ("c++", ["-x", "c++", "-std=c++11", "-fno-exceptions", "-fno-rtti"], "glimt.h"),
        ("c++", ["-x", "c++", "-std=c++17", "-pedantic"], "glimt.hpp"),
        ("c++", ["-x", "c++", "-std=c++20", "-pedantic"], "glimt.hpp"),
    ],
)
def test_header_stands_alone(compiler, flags, header, tmp_path):
    source = tmp_path / "source"
    source.write_text(
        f"#include <glimt/{header}>\n#include <glimt/{header}>\nint main(void) {{ return 0; }}\n"
    )
    command = [compiler, *flags, "-Wall", "-Wextra", "-Werror", f"-I{INCLUDE}", "-fsyntax-only", source]
    result = run(*command)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("flags", "words"),
    [(["-std=c++14"], "needs C++17"), (["-std=c++17", "-fno-exceptions"], "under -fno-exceptions use")],
)
def test_what_the_cpp_header_needs_is_said_in_words(flags, words, tmp_path):
    source = tmp_path / "source.cpp"
    source.write_text("#include <glimt/glimt.hpp>\nint main() { return 0; }\n")
    result = run("c++", *flags, f"-I{INCLUDE}", "-fsyntax-only", source)
    assert result.returncode != 0
    errors = [line for line in result.stderr.splitlines() if " error: " in line]
    assert len(errors) == 1 and words in errors[0], result.stderr


def configure(project, build, *options):
    """Configures and builds a project of somebody else's."""
    subprocess.run(["cmake", "-S", project, "-B", build, *options], check=True)
    subprocess.run(["cmake", "--build", build], check=True)


# Programs in a folder beside the one that brings glimt, so that its targets must be global.
PROJECT_IN_C = """\
    cmake_minimum_required(VERSION 3.24)
    project(user LANGUAGES C)
    set(flags "${CMAKE_BUILD_TYPE} ${CMAKE_C_FLAGS} ${BUILD_SHARED_LIBS}")
    add_subdirectory(glimt)
    add_subdirectory(programs)
    get_property(languages GLOBAL PROPERTY ENABLED_LANGUAGES)
    if("CXX" IN_LIST languages)
      message(FATAL_ERROR "a project in C got the languages ${languages}")
    endif()
    if(NOT flags STREQUAL "${CMAKE_BUILD_TYPE} ${CMAKE_C_FLAGS} ${BUILD_SHARED_LIBS}")
      message(FATAL_ERROR "flags were ${flags} before glimt was added")
    endif()
    get_property(cached DIRECTORY PROPERTY CACHE_VARIABLES)
    list(FILTER cached INCLUDE REGEX "^(EXAMPLES|TESTS|WERROR|CMAKE_CXX_COMPILER|CMAKE_CXX_FLAGS)$")
    if(cached)
      message(FATAL_ERROR "glimt left ${cached} in the cache")
    endif()
    """
PROGRAMS_IN_C = f"""\
    add_executable(user {EVALUATE})
    target_link_libraries(user PRIVATE glimt::glimt)
    add_executable(shared_user {EVALUATE})
    target_link_libraries(shared_user PRIVATE glimt::shared)
    """


@pytest.mark.parametrize("generator", ["Ninja", "Unix Makefiles"])
@pytest.mark.parametrize(
    "bring",
    [
        f"add_subdirectory({ROOT}/cpp glimt)",
        f"add_subdirectory({ROOT} glimt)",
        f"include(FetchContent)\nFetchContent_Declare(glimt SOURCE_DIR {ROOT})\n"
        "FetchContent_MakeAvailable(glimt)",
        f"include(FetchContent)\nFetchContent_Declare(glimt SOURCE_DIR {ROOT} SOURCE_SUBDIR cpp)\n"
        "FetchContent_MakeAvailable(glimt)",
    ],
    ids=["cpp", "root", "fetched", "fetched-cpp"],
)
def test_project_in_c_takes_the_sources(cpp_build, target_dir, library, bring, generator, tmp_path):
    if generator == "Ninja" and shutil.which("ninja") is None:
        pytest.skip("ninja is not installed")
    project, build = tmp_path / "project", tmp_path / "build"
    project.mkdir()
    for folder, text in [(".", PROJECT_IN_C), ("glimt", bring), ("programs", PROGRAMS_IN_C)]:
        (project / folder).mkdir(exist_ok=True)
        (project / folder / "CMakeLists.txt").write_text(textwrap.dedent(text))
    configure(project, build, "-G", generator, f"-DGLIMT_CARGO_TARGET_DIR={target_dir}")
    for program in ("user", "shared_user"):
        assert run(build / "programs" / program, library, "metal").stdout.startswith("f ")
    # Nothing of glimt is installed with the user's own files.
    subprocess.run(["cmake", "--install", build, "--prefix", tmp_path / "prefix"], check=True)
    assert not list((tmp_path / "prefix").rglob("*glimt*"))


def functions_of_headers():
    text = (INCLUDE / "glimt" / "glimt.h").read_text() + (INCLUDE / "glimt" / "image.h").read_text()
    return set(re.findall(r"\b(glimt_\w+)\(", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)))


def exported(*command):
    lines = run("nm", "--defined-only", *command).stdout.splitlines()
    return sorted(line.split()[-1] for line in lines if len(line.split()) == 3)


def test_only_the_interface_is_visible(cpp_build):
    functions = functions_of_headers()
    assert exported("--extern-only", cpp_build / "libglimt.a") == sorted(functions)
    assert exported("--dynamic", cpp_build / "libglimt.so") == sorted(functions)


OTHER_LIBRARY = {
    "Cargo.toml": """\
        [package]
        name = "other"
        version = "0.0.0"
        edition = "2021"
        [lib]
        crate-type = ["staticlib"]
        path = "lib.rs"
        [dependencies]
        cxx = "1"
        [build-dependencies]
        cxx-build = "1"
        [profile.release]
        lto = true
        [workspace]
        """,
    "build.rs": """\
        fn main() {
            cxx_build::bridge("lib.rs").std("c++17").compile("other_bridge");
        }
        """,
    "lib.rs": """\
        #[cxx::bridge]
        mod ffi {
            extern "Rust" {
                fn survives_a_panic(text: &str) -> Vec<String>;
            }
        }
        fn survives_a_panic(text: &str) -> Vec<String> {
            let panicked = std::panic::catch_unwind(|| -> usize { panic!("on purpose") }).is_err();
            vec![text.to_owned(), panicked.to_string()]
        }
        """,
    "main.cpp": """\
        #include <cstdio>
        #include <other/lib.rs.h>
        #include <glimt/glimt.hpp>
        int main(int, char **arguments) {
            for (const auto &text : survives_a_panic(glimt::Library(arguments[1]).names().at(0)))
                std::puts(std::string(text).c_str());
        }
        """,
}


def test_library_stands_beside_other_rust(cpp_build, target_dir, library, tmp_path):
    """Another static library of Rust, optimised as one piece, that has a cxx bridge of its own."""
    for name, text in OTHER_LIBRARY.items():
        (tmp_path / name).write_text(textwrap.dedent(text))
    # The versions that are there already.
    shutil.copy(ROOT / "Cargo.lock", tmp_path)
    other = target_dir / "beside"
    build = ["cargo", "build", "--release", "--offline", "--quiet"]
    subprocess.run(build, cwd=tmp_path, check=True, env={**os.environ, "CARGO_TARGET_DIR": str(other)})
    libraries = [other / "release" / "libother.a", cpp_build / "libglimt.a"]
    assert "rust_eh_personality" in run("nm", *libraries[:1]).stdout
    for order in (libraries, libraries[::-1]):
        link = ["c++", "-std=c++17", f"-I{INCLUDE}", f"-I{other / 'cxxbridge'}", tmp_path / "main.cpp"]
        result = run(*link, *order, "-lpthread", "-ldl", "-lm", "-o", tmp_path / "program")
        assert result.returncode == 0, result.stderr
        assert run(tmp_path / "program", library).stdout.split() == ["orange", "true"]


def test_pkg_config_finds_an_installed_tree_that_was_moved(cpp_build, library, tmp_path):
    if shutil.which("pkg-config") is None:
        pytest.skip("pkg-config is not installed")
    subprocess.run(["cmake", "--install", cpp_build, "--prefix", tmp_path / "first"], check=True)
    prefix = (tmp_path / "first").rename(tmp_path / "moved")
    (pc,) = prefix.rglob("glimt.pc")
    environment = {**os.environ, "PKG_CONFIG_PATH": str(pc.parent)}

    def flags(*options):
        asked = ["pkg-config", *options, "glimt"]
        return subprocess.check_output(asked, env=environment, text=True).split()

    assert flags("--modversion") == ["0.1.0"]
    result = run("cc", EVALUATE, *flags("--cflags", "--libs"), "-o", tmp_path / "shared")
    assert result.returncode == 0, result.stderr
    needed = run("readelf", "--dynamic", tmp_path / "shared").stdout
    assert "[libglimt.so.0.1]" in needed and "stdc++" not in needed
    environment["LD_LIBRARY_PATH"] = str(pc.parent.parent)
    command = [tmp_path / "shared", library, "metal"]
    assert subprocess.run(command, env=environment, capture_output=True, text=True).stdout.startswith("f ")

    archive = pc.parent.parent / "libglimt.a"
    system = [flag for flag in flags("--static", "--libs") if flag in ("-lpthread", "-ldl", "-lm")]
    assert len(system) == 3
    result = run("cc", EVALUATE, *flags("--cflags"), archive, *system, "-o", tmp_path / "static")
    assert result.returncode == 0, result.stderr
    assert run(tmp_path / "static", library, "metal").stdout.startswith("f ")


@pytest.mark.parametrize("source", ["", "cpp"])
@pytest.mark.parametrize("there", ["absolute", "relative"])
def test_environment_does_not_move_what_cargo_builds(source, there, tmp_path):
    """A habit of Rust developers: CARGO_TARGET_DIR. cxx-build writes its headers to where it points."""
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    if source == "" and any(importlib.util.find_spec(name) is None for name in ("mitsuba", "nanobind")):
        pytest.skip("Mitsuba or nanobind is not installed")
    spy = tmp_path / "bin" / "cargo"
    spy.parent.mkdir()
    spy.write_text('#!/bin/sh\necho "$CARGO_TARGET_DIR|$CARGO_BUILD_TARGET|$*" > "$SPIED"\n')
    spy.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{spy.parent}:{os.environ['PATH']}",
        "SPIED": str(tmp_path / "spied"),
        "CARGO_TARGET_DIR": str(tmp_path / "elsewhere") if there == "absolute" else "elsewhere",
        "CARGO_BUILD_TARGET": "wasm32-unknown-unknown",
    }
    build = tmp_path / "build"
    subprocess.run(["cmake", "-S", ROOT / source, "-B", build], check=True, env=environment)
    target = "glimt_cargo" if source else "cargo"
    subprocess.run(["cmake", "--build", build, "--target", target], check=True, env=environment)
    directory, triple, arguments = (tmp_path / "spied").read_text().strip().split("|")
    assert directory == str(build / "cargo") and triple == ""
    assert "--target" not in arguments


def test_installed_package_is_found(cpp_build, library, tmp_path):
    prefix, project = tmp_path / "prefix", tmp_path / "project"
    subprocess.run(["cmake", "--install", cpp_build, "--prefix", prefix], check=True)
    project.mkdir()
    (project / "CMakeLists.txt").write_text(
        textwrap.dedent(f"""\
            cmake_minimum_required(VERSION 3.24)
            project(user LANGUAGES C)
            find_package(glimt 0.1 REQUIRED)
            add_executable(user {EVALUATE})
            target_link_libraries(user PRIVATE glimt::glimt)
            add_executable(shared_user {EVALUATE})
            target_link_libraries(shared_user PRIVATE glimt::shared)
            """)
    )
    build = project / "build"
    configure(project, build, f"-DCMAKE_PREFIX_PATH={prefix}")
    for program in ("user", "shared_user"):
        assert run(build / program, library, "metal").stdout.startswith("f ")
