# SPDX-License-Identifier: Apache-2.0
"""Every file is opened in `foretouch.base.files`, and each format is decoded in one place: what else opens, unpacks or starts is listed here, with the reason."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from every_case import every_case
from test_house import FILES, ROOT, imported_modules

OPENS = re.compile(
    r"open|io\.open|os\.(open|fdopen|system|popen|exec\w*|spawn\w*|posix_spawn)"
    r"|numpy\.(load|save|savez|savez_compressed|loadtxt|savetxt|genfromtxt|fromfile|memmap)|numpy\.lib\.format\.(open_memmap|read_array)"
    r"|yaml\.(\w*load\w*|parse|scan|compose)|PIL\.Image\.open|PIL\.\w+Plugin\.\w+ImageFile"
    r"|zipfile\.(ZipFile|Path)|tarfile\.\w+|gzip\.\w+|lzma\.\w+|bz2\.(open|BZ2File)|shelve\.\w+|dbm\.\w+|mmap\.mmap"
    r"|sqlite3\.connect|apsw\.Connection|json\.load|pickle\.\w*(load|Unpickler)\w*|torch\.load|marshal\.load\w*"
    r"|h5py\.File|pandas\.read_\w+|scipy\.io\.(loadmat|whosmat|mmread)|safetensors\.(safe_open|\w+\.load_file)|zstandard\.open"
    r"|pyarrow\.(OSFile|memory_map|input_stream|output_stream)|pyarrow\.parquet\.(read_\w+|write_\w+|ParquetFile|ParquetWriter)"
    r"|rosbags\.\w+\.(Reader|Writer)|mcap\.reader\.\w+|xml\.[\w.]*parse|trimesh\.load\w*|matplotlib\.image\.im\w+|imageio\.\w+|cv2\.\w+"
    r"|subprocess\.(run|Popen|call|check_\w+|getoutput|getstatusoutput)"
)
"""Functions that open a file by its name, decode a format, or start a program."""

METHODS = {"read_text", "read_bytes", "write_text", "write_bytes", "tofile", "savefig"}
MODE = re.compile(r"[rwax][bt+]*")

DOOR = "src/foretouch/base/files.py"
ALLOWED: dict[str, dict[str, str]] = {
    # Files.
    "os.open": {
        DOOR: "the door",
        "src/foretouch/dataset/files.py": "a folder, to put its names on the disk",
        "src/foretouch/cli/main.py": "/dev/null",
        "src/foretouch/dataset/recordings/mcap.py": "a new file of the recorder, which must not exist",
        "src/foretouch/ros/runtime/environment.py": "locks of Fast DDS, only of regular files of this user",
    },
    "os.fdopen": dict.fromkeys(
        (
            DOOR,
            "src/foretouch/dataset/recordings/bag_files.py",
            "src/foretouch/dataset/recordings/edits.py",
            "src/foretouch/ros/sessions/check.py",
            "src/foretouch/report/rerun_view.py",
        ),
        "what the door has opened",
    ),
    "open": {DOOR: "the door", "src/foretouch/cli/main.py": "/dev/null"},
    "read_bytes": dict.fromkeys(
        ("src/foretouch/kernels/__init__.py", "src/foretouch/kernels/build.py"), "our own sources, below the door"
    ),
    "read_text": {
        "src/foretouch/kernels/build.py": "our own sources, below the door",
        "src/foretouch/doors.py": "entry points of installed packages, below the door",
    },
    "savefig": {"src/foretouch/report/panels.py": "to memory"},
    # Formats: each takes bytes, or a file that the door has opened.
    "yaml.load": {"src/foretouch/config.py": "the decoder of YAML, with its limits"},
    "yaml.load_all": {"src/foretouch/config.py": "the decoder of YAML, with its limits"},
    "yaml.parse": {"src/foretouch/config.py": "the decoder of YAML, with its limits"},
    "PIL.JpegImagePlugin.JpegImageFile": {"src/foretouch/cloud/io/images.py": "the decoder of images, with its limits"},
    "PIL.PngImagePlugin.PngImageFile": {
        "src/foretouch/cloud/io/images.py": "the decoder of images, with its limits",
        "src/foretouch/report/panels.py": "a figure that was just drawn",
    },
    "PIL.TiffImagePlugin.TiffImageFile": {"src/foretouch/cloud/io/images.py": "the decoder of images, with its limits"},
    "zipfile.ZipFile": {"src/foretouch/cloud/io/arrays.py": "the decoder of archives, with its limits"},
    "numpy.lib.format.read_array": {"src/foretouch/cloud/io/arrays.py": "the decoder of arrays, with its limits"},
    "numpy.loadtxt": {"src/foretouch/cloud/io/point_files.py": "of bytes"},
    "scipy.io.loadmat": {"src/foretouch/cloud/io/depth_files.py": "of bytes, after their sizes were checked"},
    "scipy.io.whosmat": {"src/foretouch/cloud/io/depth_files.py": "of bytes"},
    "trimesh.load": {
        "src/foretouch_lab/simulation/hand_surface.py": "of bytes, in a format that is named",
        "src/foretouch_lab/simulation/objects/mesh.py": "of bytes, in a format that is named",
    },
    "safetensors.numpy.load_file": {"src/foretouch/cloud/segmentation/parts.py": "weights of the package"},
    "sqlite3.connect": {
        "src/foretouch/dataset/recordings/bag_files.py": "the check of SQLite files, with a limit of steps"
    },
    "rosbags.rosbag1.Reader": {
        "src/foretouch/dataset/recordings/bag_files.py": "of regular files, with limits of unpacking"
    },
    "rosbags.rosbag2.Reader": {"src/foretouch/dataset/recordings/bag_files.py": "of regular files that were checked"},
    # New files in folders of their own.
    "numpy.savez": {
        "src/foretouch/cloud/io/files.py": "to memory",
        "src/foretouch/dataset/formats/npz.py": "an export, in its new folder",
    },
    "numpy.save": {"src/foretouch/cloud/io/files.py": "to memory"},
    "rosbags.rosbag2.Writer": {"src/foretouch/dataset/formats/rosbag2.py": "a new recording"},
    "pyarrow.OSFile": {"src/foretouch_lab/dataset/store_writer.py": "a new store"},
    "pyarrow.parquet.ParquetWriter": {"src/foretouch/dataset/formats/lerobot.py": "an export, in its new folder"},
    "pyarrow.parquet.write_table": {"src/foretouch/dataset/formats/lerobot.py": "an export, in its new folder"},
    # Programs: none that a file names or decodes.
    "subprocess.run": {
        "src/foretouch/cli/doctor.py": "our own self-test",
        "src/foretouch/report/rerun_view.py": "Rerun's viewer, which the user asks for",
        "src/foretouch_lab/experiments/framework/manifest.py": "git, for the revision of an experiment",
        "src/foretouch_lab/experiments/peers/__init__.py": "g++, for sources of ours and a checkout that the user names",
    },
    "subprocess.Popen": {"src/foretouch/report/rerun_view.py": "Rerun's viewer, which the user asks for"},
}
"""Places that may call each, with the reason."""


def openings(tree: ast.AST) -> Iterator[str]:
    """What a file calls of `OPENS` and `METHODS`, by full name."""
    names = imported_modules(tree)
    own = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        first, *rest = ast.unparse(node.func).split(".")
        full = ".".join([names.get(first, first), *rest])
        full = re.sub(r"^formats\b", "numpy.lib.format", full)  # of `arrays.py`
        if OPENS.fullmatch(full) and full not in own:
            yield full
        elif isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
            yield node.func.attr
        elif isinstance(node.func, ast.Attribute) and node.func.attr == "open":
            texts = [
                one.value for one in (*node.args, *(k.value for k in node.keywords)) if isinstance(one, ast.Constant)
            ]
            if any(isinstance(text, str) and MODE.fullmatch(text) for text in texts):
                yield "open"


def test_files_are_opened_and_decoded_in_the_listed_places_only() -> None:
    found: dict[str, set[str]] = {}
    for path, tree in FILES.items():
        for name in openings(tree):
            found.setdefault(name, set()).add(path.relative_to(ROOT).as_posix())
    assert {name: sorted(places) for name, places in sorted(found.items())} == {
        name: sorted(places) for name, places in sorted(ALLOWED.items())
    }


def test_the_check_finds_each_kind() -> None:
    code = {
        "open": "open('x')",
        "open ": "from pathlib import Path\nPath('x').open('rb')",
        "read_text": "path.read_text()",
        "numpy.load": "import numpy as np\nnp.load('x')",
        "yaml.safe_load": "import yaml\nyaml.safe_load('x')",
        "PIL.Image.open": "from PIL import Image\nImage.open('x')",
        "zipfile.ZipFile": "import zipfile\nzipfile.ZipFile('x')",
        "sqlite3.connect": "from sqlite3 import connect\nconnect('x')",
        "subprocess.run": "import subprocess as s\ns.run(['gs'])",
        "pyarrow.memory_map": "import pyarrow as pa\npa.memory_map('x')",
    }

    def check(name: str, text: str) -> None:
        assert list(openings(ast.parse(text))) == [name.strip()]

    every_case(list(code.items()), check)
    assert list(openings(ast.parse("queue.open(3)\nfile.seek(0)"))) == []


def test_reasons_are_of_files_that_exist() -> None:
    assert all((ROOT / place).is_file() and reason for places in ALLOWED.values() for place, reason in places.items())
    assert Path(ROOT / DOOR).is_file()
