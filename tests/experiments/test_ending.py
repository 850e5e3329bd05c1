"""How commands end."""

import errno

import pytest

from experiments.ending import exit_status


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ValueError("no such task"), 2, "work: no such task\n"),
        (FileNotFoundError("nothing there"), 2, "work: nothing there\n"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "/proc/x"), 2, "on from here\n"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "the same command goes on from here\n"),
        (KeyboardInterrupt(), 130, "work: interrupted; the same command goes on from here\n"),
    ],
)
def test_every_end_has_its_status_and_one_sentence(error, status, said, capsys):
    def fails() -> int:
        raise error

    assert exit_status("work", fails) == status
    told = capsys.readouterr().err
    assert told.startswith("work: ") and told.endswith(said) and told.count("\n") == 1
    assert "[Errno" not in told
    assert exit_status("work", fails, goes_on=False) == status
    assert "goes on" not in capsys.readouterr().err
    assert exit_status("work", lambda: 1) == 1 and capsys.readouterr().err == ""


def test_what_is_a_mistake_of_the_program_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        exit_status("work", lambda: 1 // 0)
