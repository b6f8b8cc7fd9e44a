from facewright.cli import photo_options


def test_remarks_are_said_aside(capsys):
    photo_options.say_remarks(("2 faces were found.",))
    out, err = capsys.readouterr()
    assert out == "" and "2 faces were found." in err


def test_remarks_begin_like_sentences_but_names_of_files_stay(capsys):
    photo_options.say_remarks(["anim.gif holds 2 frames, the first is used.", "no face in 1 of 3 frames.", "Two."])
    assert capsys.readouterr().err.splitlines() == [
        "anim.gif holds 2 frames, the first is used.",
        "No face in 1 of 3 frames.",
        "Two.",
    ]
