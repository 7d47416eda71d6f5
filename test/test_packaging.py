# SPDX-License-Identifier: Apache-2.0
"""What holds for the package as a whole: one version, a core without ROS, a prompt command line."""

import ast
import json
import os
import pkgutil
import re
import shutil
import sys
import xml.etree.ElementTree as ET
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_answer import run_python
from packaging.requirements import Requirement

import foretouch

ROOT = Path(__file__).parents[1]
PACKAGES = {name: ROOT / "src" / name for name in ("foretouch", "foretouch_lab")}
ROS_PACKAGES = (
    *(f"{name}_msgs" for name in ("diagnostic", "foretouch", "geometry", "lifecycle", "sensor", "shape", "std")),
    *("visualization_msgs", "std_srvs", "rcl_interfaces", "builtin_interfaces"),
)
OUTER = {"ros", "camera", "__main__", "kernels"}
ROBOT = (  # what a robot runs: the nodes, and the modules of the commands `run`, `predict`, `record`, `replay` and `view`
    *(
        f"foretouch.ros.nodes.{module.name}"
        for module in pkgutil.iter_modules([str(PACKAGES["foretouch"] / "ros" / "nodes")])
    ),
    *(f"foretouch.cli.{name}" for name in ("main", "run", "predict", "record", "replay", "view")),
)


def test_the_version_is_one() -> None:
    for folder in (".", "foretouch_msgs"):
        version = ET.parse(ROOT / folder / "package.xml").getroot().findtext("version")
        assert version == foretouch.__version__, folder
    assert f"\nversion: {foretouch.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    pytest.importorskip("foretouch_msgs", reason="foretouch_msgs is not installed")
    assert metadata.version("foretouch_msgs") == foretouch.__version__


@pytest.mark.slow
def test_every_core_module_imports_without_ros() -> None:
    names = []
    for package, folder in PACKAGES.items():
        core = [module.name for module in pkgutil.iter_modules([str(folder)]) if module.name not in OUTER]
        below = [f"{name}.{module.name}" for name in core for module in pkgutil.iter_modules([str(folder / name)])]
        names += [f"{package}.{name}" for name in core + below]
    done = run_python(
        f"import importlib, sys\nfor name in {names!r}: importlib.import_module(name)\n"
        "print([name for name in sys.modules if name == 'rclpy' or name.endswith('_msgs')])"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_a_robot_loads_nothing_of_the_laboratory() -> None:
    pytest.importorskip("foretouch_msgs.msg", reason="foretouch_msgs is not installed")
    done = run_python(
        "import importlib, sys\n"
        "from foretouch.ros.runtime.environment import prepare_environment\nprepare_environment()\n"
        f"for name in {ROBOT!r}: importlib.import_module(name)\n"
        "ours = [one for name, one in sys.modules.items() if name.partition('.')[0] in ('foretouch', 'foretouch_lab')]\n"
        "print([one.__name__ for one in ours if one.__name__.startswith('foretouch_lab')])\n"
        "print([name for name in ('sklearn', 'embreex', 'threadpoolctl', 'ray') if name in sys.modules])\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-2:] == ["[]", "[]"]


MOST_MODULES = 200  # that `--help` loads, most of them of Python
SCENE = str(ROOT / "config/scenes/clean.yaml")


@pytest.mark.parametrize(
    ("blocked", "fault", "commands"),
    [
        (
            "foretouch_lab",
            r"there is no module foretouch_lab\S*: pip install --force-reinstall foretouch",
            {
                "command simulate": ["simulate", "scene.yaml", "-n", "1", "-o", "store"],
                "command dataset.build": ["dataset", "build", "session", "-o", "store"],
                f"--source {SCENE}": ["run", "--source", SCENE],
            },
        ),
        (
            "embreex",
            r"embreex is not installed: pip install 'foretouch\[lab\]'",
            {"simulate": ["simulate", SCENE, "-n", "1", "-o", "store", "--workers", "1"]},
        ),
    ],
)
def test_a_command_without_the_laboratory_names_the_extra_to_install(blocked, fault, commands, tmp_path) -> None:
    for user, answer in zip(commands, _answers_without((blocked,), [*commands.values()], tmp_path), strict=True):
        (line,) = [one for one in answer.splitlines() if one.startswith("foretouch: ")]
        assert re.fullmatch(rf"foretouch: {re.escape(user)}: {fault}", line)
        assert "Traceback" not in answer


def test_a_command_without_ros_says_so_in_one_line(tmp_path) -> None:
    run, record = ["run", "--source", "TOPIC"], ["record", "-o", "out"]
    commands = [run, record, ["replay", str(ROOT / "examples/data/can.ply")], ["forget", "touches"]]
    for words, answer in zip(commands, _answers_without(("rclpy", *ROS_PACKAGES), commands, tmp_path), strict=True):
        assert answer.count("\n") == 1, answer
        assert answer.startswith(f"foretouch: {words[0]}: ROS 2 is not installed: pip install 'foretouch[ros]'")
    for answer in _answers_without(("foretouch_msgs",), [run, record], tmp_path):
        assert "foretouch_msgs is not installed" in answer


def _answers_without(blocked: tuple[str, ...], commands: list[list[str]], folder: Path) -> list[str]:
    """What commands write to stderr in a process that cannot import some modules; each must end with 1."""
    code = (
        f"import contextlib, io, json, sys\nsys.modules.update(dict.fromkeys({blocked!r}))\n"
        f"from foretouch.cli.main import main\nanswers = []\nfor words in {commands!r}:\n"
        "    with contextlib.redirect_stderr(io.StringIO()) as err: status = main(words)\n"
        "    answers.append(err.getvalue() if status == 1 else f'exit status {status}')\n"
        "print(json.dumps(answers))"
    )
    done = run_python(code, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_help_answers_at_once_and_without_heavy_libraries() -> None:
    done = run_python(
        "import sys\nfrom foretouch.cli.main import main\n"
        "try: main(['predict', '--help'])\nexcept SystemExit: pass\n"
        "print([n for n in ('torch', 'open3d', 'scipy', 'rclpy', 'matplotlib', 'rosbags') if n in sys.modules])"
    )
    assert done.stdout.strip().endswith("[]"), done.stderr
    done = run_python(
        "import sys\nfrom foretouch.cli.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\nprint(len(sys.modules))"
    )
    assert int(done.stdout.split()[-1]) < MOST_MODULES, done.stderr


IMPORT_NAMES = {  # of distributions whose modules are named otherwise
    "PyYAML": "yaml",
    "scikit-learn": "sklearn",
    "python-neo-lzf": "lzf",
    "libusb-package": "libusb_package",
    "pillow": "PIL",
    "rerun-sdk": "rerun",
    "foxglove-sdk": "foxglove",
}
NOT_IN_ROSDEP = {
    "safetensors",
    "embreex",
    "lazy_loader",
    "mcap",
    "pyarrow",
    "rosbags",
    "threadpoolctl",
    "trimesh",
    "lzf",
}
OPTIONAL = ("lab", "sim", "hdf5", "tables", "camera", "sweep", "open3d", "view", "serve", "urdf")
ONLY_IN_FULL_ROS = {"sr_robot_msgs", "tf2_ros"}
COMES_WITH = {"mpl_toolkits": "matplotlib"}


def imported(*folders: str) -> set[str]:
    """Names of the top-level modules that are imported anywhere in the folders, those of Python and ours left out."""
    found = set()
    for folder in folders:
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    found.add(node.module.partition(".")[0])
    ours = {*PACKAGES, "foretouch_launch_helpers"}
    return {COMES_WITH.get(name, name) for name in found - ours if name not in sys.stdlib_module_names}


def required(*extras: str | None) -> dict[str, Requirement]:
    """Requirements of the metadata by import name, of the package itself (None) or of extras."""
    lines = [Requirement(line) for line in metadata.requires("foretouch") or []]
    wanted = [line for line in lines for extra in extras if (line.marker is None) == (extra is None)]
    kept = [one for one in wanted if one.marker is None or any(one.marker.evaluate({"extra": e or ""}) for e in extras)]
    return {IMPORT_NAMES.get(one.name, one.name.replace("-", "_")): one for one in kept}


@pytest.mark.slow
def test_the_metadata_and_package_xml_require_what_is_imported() -> None:
    ros = {name.removeprefix("ros_jazzy_") for name in required("ros")}
    assert ros == {name.removeprefix("ros_") for name in required("kilted")}
    others = {"foretouch_msgs", "rcl_interfaces", "builtin_interfaces", "std_msgs", "ament_index_python", "action_msgs"}
    robot = imported("src/foretouch") - ros - others
    assert robot - set(required(*OPTIONAL)) - ONLY_IN_FULL_ROS == set(required(None))
    laboratory = imported("src/foretouch_lab") - ros - others - set(required(None, "open3d", "sweep", "urdf"))
    assert laboratory == set(required("lab"))
    assert not robot & laboratory
    declared = {one.text or "" for one in ET.parse(ROOT / "package.xml").getroot().findall("exec_depend")}
    renamed = {"pil": "PIL", "tf2_ros_py": "tf2_ros"}
    modules = {renamed.get(name, name) for name in (one.removeprefix("python3-") for one in declared)}
    needed = imported("src", "launch")
    assert needed - modules - set(required(*OPTIONAL)) - ONLY_IN_FULL_ROS - NOT_IN_ROSDEP == set()
    assert modules - needed == {"rviz2", "ros2launch", "vision_msgs"}  # of launch files, and found by name


def test_the_installation_page_installs_what_rosdep_does_not_know() -> None:
    text = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^pip install -c src/foretouch/constraints.txt (.*)$", text, re.MULTILINE)
    assert {IMPORT_NAMES.get(name, name) for name in line.split()} == NOT_IN_ROSDEP
    extras = metadata.metadata("foretouch").get_all("Provides-Extra") or []
    assert {f"`{extra}`" for extra in extras} <= set(re.findall(r"`\w+`", text))


def test_the_constraints_are_within_the_ranges_and_complete() -> None:
    files = [ROOT / f"constraints{name}.txt" for name in ("", "-kilted", "-jazzy")]
    lines = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    pins = {one.name: str(one.specifier)[2:] for one in map(Requirement, (x for x in lines if not x.startswith("#")))}
    every = [Requirement(line) for line in metadata.requires("foretouch") or []]
    for one in every:
        exact = str(one.specifier).startswith("==")
        assert exact or one.specifier.contains(pins[one.name]), one
    assert pins.keys() <= {one.name for one in every}


def test_a_build_without_cffi_fails_in_one_line_and_colcon_can_still_ask() -> None:
    code = "import runpy, sys; sys.modules['cffi'] = None; sys.argv = {words!r}; runpy.run_path('setup.py', run_name='__main__')"
    done = run_python(code.format(words=["setup.py", "build_ext"]), cwd=ROOT)
    assert done.returncode == 1
    assert re.fullmatch(r"foretouch: cffi, .* is not installed: pip install cffi .*\n", done.stderr), done.stderr
    asked = run_python(  # as colcon does
        "import sys; sys.modules['cffi'] = None; import setuptools; from distutils.core import run_setup\n"
        "print(run_setup('setup.py', script_args=('--dry-run',), stop_after='config').get_name())",
        cwd=ROOT,
    )
    assert (asked.returncode, asked.stdout.split()[-1:]) == (0, ["foretouch"]), asked.stderr
    depends = ET.parse(ROOT / "package.xml").getroot()
    assert all("python3-cffi" in {one.text for one in depends.findall(f"{kind}_depend")} for kind in ("build", "exec"))
    assert "python3-cffi" in (ROOT / "docs" / "install.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def unpacked_wheel(tmp_path_factory) -> Path:
    """The content of the wheel, as `pip install foretouch` would install it."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # built in a copy: setuptools leaves its build folder beside setup.py
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "test", "docs", "benchmarks", "*.so"))
    code = f"import sys; sys.path.insert(0, ''); from setuptools import build_meta; build_meta.build_wheel({str(folder)!r})"
    done = run_python(code, cwd=source)
    assert done.returncode == 0, done.stderr[-2000:]
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


@pytest.mark.slow
def test_the_wheel_predicts_without_ros(unpacked_wheel, tmp_path) -> None:
    """In a process in which nothing of ROS can be imported, with nothing but the wheel."""
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "can.npz", xyz=rng.normal((0.0, 0.0, 0.8), 0.02, (2000, 3)).astype(np.float32))
    code = (
        "import sys\n"
        "class NoRos:\n"
        "    def find_spec(self, name, *_):\n"
        "        top = name.partition('.')[0]\n"
        "        if top in ('rclpy', 'open3d', 'pyrealsense2') or top.endswith('_msgs') or top.startswith('ros_'):\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, NoRos())\n"
        "import foretouch.kernels\n"
        f"assert foretouch.__file__.startswith({str(unpacked_wheel)!r}), foretouch.__file__\n"
        "from foretouch.cli.main import main\n"
        f"sys.exit(main(['predict', {str(tmp_path / 'can.npz')!r}, '--json']))\n"
    )
    done = run_python(code, env={**os.environ, "PYTHONPATH": str(unpacked_wheel)}, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[0])["predictions"][0]["PDC_TH"]["value"] > 0.0
    assert (unpacked_wheel / "foretouch_lab" / "py.typed").exists()
    for folder, ours in (
        ("simulation/scenes", "scenes"),
        ("learning/recipes/train", "train"),
        ("learning/recipes/models", "models"),
    ):
        packed = {path.name for path in (unpacked_wheel / "foretouch_lab" / folder).iterdir()}
        assert packed == {path.name for path in (ROOT / "config" / ours).iterdir()}
    sensors = {path.name for path in (unpacked_wheel / "foretouch" / "tactile" / "sensors").iterdir()}
    assert sensors == {path.name for path in (ROOT / "config" / "sensors").iterdir()}
    (file,) = unpacked_wheel.glob("*.dist-info/METADATA")
    text = file.read_text(encoding="utf-8")
    assert "Requires-Python: >=3.11" in text
    assert "Project-URL: " in text
    assert "==" not in "".join(re.findall(r"^Requires-Dist: (?!.*extra ==).*", text, re.MULTILINE))


def test_the_workflow_runs_what_ci_runs() -> None:
    (job,) = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8"))["jobs"].values()
    targets = {entry["target"] for entry in job["strategy"]["matrix"]["include"]}
    assert "make check" in (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "check" in targets
    assert job["steps"][-1]["run"] == "make ${{ matrix.target }} ROS=${{ matrix.ros }}"
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert all(re.search(rf"^{target}: setup$", makefile, re.MULTILINE) for target in targets)
