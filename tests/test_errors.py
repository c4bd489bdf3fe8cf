"""Messages of errors: facts below, words at the edges."""

import pickle

from depthcli.errors import InputError, Message, UsageError


def flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def test_error_names_parameters_and_the_command_line_its_options() -> None:
    error = InputError("{a}.png has 9 pixels", "raise {max_pixels} if you trust the file")
    assert str(error) == "{a}.png has 9 pixels; raise max_pixels if you trust the file"
    assert error.message.worded(flag).endswith("; raise --max-pixels if you trust the file")
    assert error.message.worded(flag).startswith("{a}.png")


def test_wrong_value_is_told_with_its_option() -> None:
    error = UsageError("3/2 is not I/N", option="shard")
    assert str(error) == "shard: 3/2 is not I/N"
    assert error.message.worded(flag) == "--shard: 3/2 is not I/N"


def test_message_keeps_its_facts_in_another_process_and_another_error() -> None:
    message = Message("flat", "give {anchor}", option="anchors").about("a.png")
    copy = pickle.loads(pickle.dumps(InputError(message)))  # noqa: S301 - its own
    assert copy.message == message == "anchors: a.png: flat; give anchor"
    assert copy.message.advice == "give {anchor}"


def test_option_with_a_digit_is_named() -> None:
    assert Message("", "{float_model} is for {int8}").worded(flag) == "--float-model is for --int8"
