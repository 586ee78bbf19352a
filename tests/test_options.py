"""The command line, TOML files and keywords take all options from one dataclass."""

import argparse
import inspect
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal, get_type_hints

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig, MakeOptions
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.options import Option, add_options, given_options, options_of, read_options


@dataclass(frozen=True)
class Oven:
    heat: Annotated[float, Option("how hot", unit="degrees")] = 180.0
    fan: Annotated[Literal["on", "off"], Option("of the fan")] = "on"


def test_a_command_line_gives_the_options_of_a_dataclass_and_leaves_out_the_others() -> None:
    parser = argparse.ArgumentParser()
    add_options(parser, Oven)
    assert given_options(parser.parse_args(["--heat", "200"]), Oven) == {"heat": 200.0}
    assert given_options(parser.parse_args(["--fan", "off"]), Oven) == {"fan": "off"}
    assert "how hot [degrees] (default: 180.0)" in " ".join(parser.format_help().split())


def test_a_name_that_is_not_known_is_answered_with_one_like_it(tmp_path: Path) -> None:
    file = tmp_path / "oven.toml"
    file.write_text("haet = 200\n")
    with pytest.raises(ConfigError, match=r"no option is called haet: .*did you mean heat\?"):
        read_options(file, {found.name for found in options_of(Oven)})
    with pytest.raises(ConfigError, match=r"no option resolutoin: .*did you mean resolution\?"):
        GeneratedGarments(1, resolutoin=2.0)  # type: ignore[call-arg]


def test_every_field_of_the_config_is_an_option_with_help() -> None:
    options = options_of(MakeConfig)
    assert [found.name for found in options] == [entry.name for entry in fields(MakeConfig)]
    assert all(found.option.help for found in options)


def test_keywords_have_the_names_and_types_of_the_config() -> None:
    config, keywords = get_type_hints(MakeConfig), get_type_hints(MakeOptions)
    own = inspect.signature(GeneratedGarments.__init__).parameters
    assert {*keywords, *own} >= set(config)
    assert keywords == {name: config[name] for name in keywords}


def test_generate_takes_every_option_of_the_config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["generate", "--help"])
    message = " ".join(capsys.readouterr().out.split())
    for found in options_of(MakeConfig):
        assert found.name == "design" or f"{found.flag} " in message
    narrow = ["--stage", "mesh", "--resolution", "8", "--points", "16", "--bodies-each", "2", "--arms", "5"]
    assert main(["generate", str(tmp_path / "set"), "--count", "2", "--quiet", *narrow]) == 0
