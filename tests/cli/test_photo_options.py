from facewright.cli import photo_options


def test_remarks_are_said_aside(capsys):
    photo_options.say_remarks(("2 faces were found.",))
    out, err = capsys.readouterr()
    assert out == "" and "2 faces were found." in err
