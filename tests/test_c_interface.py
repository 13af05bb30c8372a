"""The C and C++ interface: its promises, its examples, and every way in which it is compiled."""

import subprocess
import textwrap

import pytest
from conftest import ROOT
from model_libraries import write_library

INCLUDE = ROOT / "cpp" / "include"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return write_library(tmp_path_factory.mktemp("library") / "hybrid.safetensors", "hybrid")


def run(*command):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True)


def test_interface_keeps_its_promises(cpp_build, library):
    result = run(cpp_build / "interface", library, "metal")
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


def test_installed_package_is_found(cpp_build, library, tmp_path):
    prefix, project = tmp_path / "prefix", tmp_path / "project"
    subprocess.run(["cmake", "--install", cpp_build, "--prefix", prefix], check=True)
    project.mkdir()
    (project / "CMakeLists.txt").write_text(
        textwrap.dedent(f"""\
            cmake_minimum_required(VERSION 3.24)
            project(user LANGUAGES C CXX)
            find_package(glimt 0.1 REQUIRED)
            add_executable(user {ROOT / "cpp" / "examples" / "evaluate.c"})
            target_link_libraries(user PRIVATE glimt::glimt)
            """)
    )
    build = project / "build"
    subprocess.run(["cmake", "-S", project, "-B", build, f"-DCMAKE_PREFIX_PATH={prefix}"], check=True)
    subprocess.run(["cmake", "--build", build], check=True)
    assert run(build / "user", library, "metal").stdout.startswith("f ")
