# SPDX-License-Identifier: Apache-2.0
"""The words of a command: help, and refusals of what is misspelled or a number that cannot be used, with the nearest known name."""

import argparse
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from every_case import every_case

from foretouch.cli.commands import COMMANDS
from foretouch.cli.main import command_parser, main
from foretouch.cli.parser import EXAMPLES

CONFIG = Path(__file__).parents[2] / "config"


def parsers() -> Iterator[argparse.ArgumentParser]:
    """Of each command, and of its actions."""
    yield command_parser(None)
    for command in (name for name in COMMANDS if "." not in name):
        parser = command_parser(command).commands[command]
        yield parser
        yield from parser.commands.values()


def test_help_fits_any_width_of_a_terminal(monkeypatch) -> None:
    def check(columns: str) -> None:
        monkeypatch.setenv("COLUMNS", columns)
        assert all("exit status:" in parser.format_help() for parser in parsers())

    every_case(["0", "1", "3", "-5", "words", "100000"], check)


def test_the_help_of_every_command_has_an_example_defaults_groups_and_exit_statuses(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    found = {parser.prog.partition(" ")[2]: parser for parser in parsers()}
    examples = {**EXAMPLES, **{name.replace(".", " "): COMMANDS.load(name).example for name in COMMANDS}}
    assert set(found) == set(examples)

    def check(parser: argparse.ArgumentParser) -> None:
        text, example = parser.format_help(), examples[parser.prog.partition(" ")[2]]
        assert max(map(len, text.splitlines())) <= 80
        assert re.search(r"exit status:\n  0 done; 1 .*; 2 wrong", text)
        assert f"example:\n  {example[:60]}" in text
        words = shlex.split(example)
        assert " ".join(words).startswith(parser.prog)
        command_parser(words[1]).parse_args(words[1:])  # or argparse ends the process
        options = [option for option in parser.declared if option.option_strings and option.dest != "version"]
        for option in options:
            assert option.option_strings[-1] in text
            if option.nargs != 0:
                assert re.search("default|required", option.help), option.dest
        if len(options) > 10:
            assert len(re.findall(r"^([a-z].*):$", text, re.MULTILINE)) >= 4
            others = text.partition("options:\n")[2].partition("\n\n")[0]
            assert others.split() == ["-h,", "--help", "print", "this", "help", "and", "end"], others

    every_case(found, check)


def test_words_and_numbers_of_no_use_are_usage_errors_with_the_nearest_word(capsys) -> None:
    cases = (
        ("evalute default store", "'evalute' is not one of segment, ", "did you mean evaluate?"),
        ("dataset infoo store", "'infoo' is not one of info, ", "did you mean info?"),
        ("run --source x --color ''", "--color: is empty; give a value, or leave it out"),
        ("predict x --color=", "--color: is empty; give a value, or leave it out"),
        ("predict ''", "an argument: is empty; give a value, or leave it out"),
        ("run --source x --pictrue y.png", "--pictrue: there is no such option; did you mean --picture?"),
        ("predict x --count 3", "--count: there is no such option; give --set grasp.count=K\n"),
        ("dataset import x --map y", "--map: there is no such option\n"),
        ("grasp x.pcd --target nearst", "'nearst' is not one of nearest, ", "did you mean nearest?"),
        ("dataset import x -o y --topic tactil=/x", "--topic: 'tactil=/x' is not KIND=NAME with a kind of clouds"),
        ("record -o none --seconds -1", "--seconds: -1 is not above 0"),
        ("run --source none --count 0", "--count: 0 is not 1 or more"),
        ("replay none --rate fast", "--rate: 'fast' is not a finite number"),
        ("train none -o none --workers 2.5", "--workers: '2.5' is not a whole number"),
        ("run --source none --plane 0,0,1", "--plane: '0,0,1' is not 4 numbers with commas between them"),
        ("run --source none --serve localhost:", "--serve: 'localhost:' is not HOST:PORT, such as 127.0.0.1:8765"),
        ("run --source none --serve 127.0.0.1:99999", "is not HOST:PORT"),
    )

    def check(line: str, *texts: str) -> None:
        with pytest.raises(SystemExit, match="2"):
            main(shlex.split(line))
        err = capsys.readouterr().err
        assert all(text in err for text in texts), err

    every_case(cases, check)


def test_numbers_that_begin_below_0_belong_to_their_option() -> None:
    parser = command_parser("predict")
    for option, text in (
        ("--grasp", "-0.042,-.007,1.198,0.002,0.028,1.198"),
        ("--point", "-.1,0,1"),
        ("--plane", "-0,0,-1,1"),
    ):
        apart, joined = (
            parser.parse_args(["predict", "x", option, text]),
            parser.parse_args(["predict", "x", f"{option}={text}"]),
        )
        assert vars(apart) == vars(joined), option


MAY_BE_ZERO = ("--seed", "--width", "--vary", "--wait-limit")
CHECKED_LATER = {"grasp --tip-mm": "tip_mm", "grasp --count": "count", "grasp --slide-m": "slide_m"}
"""Options whose bounds are those of a setting, and its name in the error."""


def _takes_a_number(kind: Callable[[str], object]) -> bool:
    try:
        return isinstance(kind("7"), int | float)
    except argparse.ArgumentTypeError:  # such as four numbers
        return False


def test_every_option_of_a_number_refuses_what_no_command_can_use(call, files) -> None:
    options = {
        f"{parser.prog.removeprefix('foretouch ')} {action.option_strings[-1]}": action.type
        for parser in parsers()
        for action in parser._actions
        if callable(action.type) and _takes_a_number(action.type)
    }
    assert {"record --seconds", "dataset build --seed", *CHECKED_LATER} <= set(options)

    def check(name: str, text: str) -> None:
        if text == "0" and name.endswith(MAY_BE_ZERO):
            assert options[name](text) == 0
            return
        with pytest.raises(argparse.ArgumentTypeError, match=f"{text!r} is not |{text} is not "):
            options[name](text)

    parsed = options.keys() - CHECKED_LATER.keys()
    every_case([(name, text) for name in parsed for text in ("-1", "0", "nan", "inf", "x", "")], check)
    for name, text in (
        ("grasp --tip-mm", "nan"),
        ("grasp --tip-mm", "0"),
        ("grasp --count", "0"),
        ("grasp --slide-m", "inf"),
    ):
        call("grasp", files / "object.pcd", name.split()[1], text).check_refused(CHECKED_LATER[name])


def test_what_may_be_left_out_is_not_called_required(capsys: pytest.CaptureFixture[str]) -> None:
    for command, missing in (("train", "CONFIG"), ("experiment", "NAME"), ("tradeoff", "AREA")):
        with pytest.raises(SystemExit):
            command_parser(command).parse_args([command])
        assert capsys.readouterr().err.endswith(f"the following arguments are required: {missing}\n")


SCENE = "objects:\n  - {name: can, shape: can, size_m: [0.07, 0.07, 0.1]}\n"
FIELDS = (  # of a scene, of the pipeline, of a training
    ("simulate", SCENE + "camera: {noize: {}}", "camera.noize", "noise"),
    ("segment", "segmentation: {crop: {max_rnage_m: 1.0}}", "segmentation.crop.max_rnage_m", "max_range_m"),
    ("train", "methd: contact", "methd", "method"),
)
NAMES = (  # recipes, experiments, presets, areas, models, settings of a command
    ("train p3 data=x -o y", "p3: is neither a file nor one of contact-v3, p1, p1_as_published, p2", "p2"),
    ("experiment prequental -o y", "'prequental'", "prequential"),
    ("experiment prequential -o y --preset smokee", "'smokee'", "smoke"),
    ("tradeoff modle -o y", "'modle'", "model"),
    ("predict x.pcd --model contact_v2", "contact_v2", "contact-v3"),
    (f"simulate {CONFIG}/scenes/clean.yaml --explain --set camera.noize={{}}", "--set: camera.noize: unknown", "noise"),
    ("train contact-v3 trees=3 data=x -o y", "trees", "contact.trees"),
    ("record -o y --set tactile_topc=/x", "--set: tactile_topc: unknown setting", "tactile_topic"),
)


def test_fields_and_names_are_refused_with_the_nearest_known_one(call, files, tmp_path) -> None:
    def check_field(command: str, text: str, field: str, nearest: str) -> None:
        path = tmp_path / "own.yaml"
        path.write_text(text + "\n")
        words = {"simulate": (path, "--explain"), "segment": (files / "scene.npz", "--config", path)}
        answer = call(command, *words.get(command, (path, "data=x", "-o", "y")))
        for part in (f"{path}", f": {field}: unknown setting; known: ", f"; did you mean {nearest}?"):
            answer.check_refused(part)

    def check_name(words: str, name: str, nearest: str) -> None:
        answer = call(*words.split())
        answer.check_refused(name)
        answer.check_refused(f"did you mean {nearest}?")

    every_case(FIELDS, check_field)
    every_case(NAMES, check_name)


REFUSED = (  # nodes and parameters of a file
    ("/foretouch/perceptoin", "autostart: true", "did you mean /foretouch/perception?"),
    ("/foretuch/grasp", "autostart: true", "did you mean /foretouch/grasp?"),
    ("perception", "autostart: true", "did you mean /foretouch/perception?"),
    ("/left/perceptoin", "autostart: true", "did you mean /foretouch/perception?"),
    ("/foretouch/touch_predictor", "use_tarre: false", ": use_tarre: unknown parameter; did you mean use_tare?"),
    ("/foretouch/grasp", "use_tare: false", ": use_tare: unknown parameter"),  # a parameter of another node
    ("/foretouch/grasp", "off: 2", ": False: unknown parameter"),  # which YAML reads so
    ("/foretouch/perception", "latency_budget_ms: 5.0", "latency_budget_ms: was removed in 0.4"),
    ("/**", "late_after: 5.0", "did you mean late_after_s?"),
    ("/foretouch/*", "silense_s: 3.0", "did you mean silence_s?"),
    ("/foretouch/recorder", "points:", "points: is empty"),
    ("/foretouch/touch_predictor", "hand: right", "hand: is called hand_name since 0.4"),
    ("/foretouch/segmentation", "queue_depth: 3", "queue_depth: was removed in 0.4: the newest cloud is answered next"),
)
ACCEPTED = (
    ("/foretouch/touch_predictor", "{use_tare: false, use_sim_time: true}"),
    ("/foretouch:\n touch_predictor", "use_tare: false"),  # a namespace
    ("/**", "{use_tare: false, qos_overrides./foretouch/touch.publisher.depth: 3}"),
    ("/**/grasp", "grasp.count: 3"),
    ("/left/grasp", "grasp.count: 3"),
    ("/robot2/grasp", "grasp.count: 3", "/robot1"),
    ("/move_group", "anything: 3"),
)


def test_nodes_and_parameters_in_files_and_on_the_command_line(call, tmp_path) -> None:
    pytest.importorskip("rclpy")
    from foretouch.errors import ConfigError
    from foretouch.ros.nodes import NODES as KNOWN
    from foretouch.ros.runtime.parameter_files import check_parameters

    path = tmp_path / "robot.yaml"

    def check_refused(node: str, text: str, wanted: str) -> None:
        path.write_text(f"{node}:\n  ros__parameters:\n    {text}\n")
        answer = call("record", "-o", tmp_path / "out", "--params", path)
        answer.check_refused(f"{path}: /{node.strip('/')}: ")
        answer.check_refused(wanted)

    def check_accepted(node: str, text: str, namespace: str = "/foretouch") -> None:
        path.write_text(f"{node}:\n  ros__parameters:\n    {text}\n")
        check_parameters(["--ros-args", "--params-file", str(path)], KNOWN, {"grasp": {}}, namespace)

    every_case(REFUSED, check_refused)
    every_case(ACCEPTED, check_accepted)
    for words, text in (
        (["-p", "use_tare:=false"], "-p use_tare:=false: use_tare: unknown parameter"),
        (["--param", "touch_predictor:use_tarre:=false"], "did you mean use_tare?"),
    ):
        with pytest.raises(ConfigError) as err:
            check_parameters(["--ros-args", *words], KNOWN, {"grasp": {}}, "/foretouch")
        assert text in str(err.value)
    check_parameters(["--ros-args", "-p", "grasp.count:=3"], KNOWN, {"grasp": {}}, "/foretouch")
    path.write_text("/foretouch/touch_predictor:\n  ros__parameters:\n    model: default\n")  # of a single step
    arguments = ["--ros-args", "--params-file", str(path)]
    check_parameters(arguments, KNOWN, {"touch_predictor": {}}, "/foretouch")
    with pytest.raises(ConfigError) as err:
        check_parameters(arguments, KNOWN, {"perception": {}}, "/foretouch")
    rule = "model: the node /foretouch/perception has these parameters since 0.4: move them there"
    assert str(err.value) == f"{path}: /foretouch/touch_predictor: {rule}"
    with pytest.raises(ConfigError, match=r"node grasp: grasp.cuont: unknown parameter; did you mean grasp.count\?"):
        check_parameters([], KNOWN, {"grasp": {"grasp.cuont": 3}}, "/foretouch")
