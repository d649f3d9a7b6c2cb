from mavfi.cli.commands import run


def test_the_answer_comes_first_and_the_picture_is_drawn(tmp_path, capsys):
    picture = tmp_path / "red.png"
    assert run(["redundancy", "--picture", str(picture)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("airsim_uav (logged power): with TMR it takes 1.06 times as long")
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_a_file_of_the_users_own(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nmass: 0.9\nmax_thrust: 18\n", encoding="utf-8")
    assert run(["redundancy", "--vehicle", str(path)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("mine (own): with TMR it ") and all(name in text for name in ("autoencoder", "DMR"))


def test_bad_input_is_one_line(tmp_path, capsys):
    assert run(["redundancy", "--vehicle", "balloon"]) == 2
    assert "redundancy 'balloon': not known; allowed: airsim_uav, airsim_uav_tdp, dji_spark" in capsys.readouterr().err
    assert run(["redundancy", "--picture", str(tmp_path / "x.txt")]) == 2
    assert run(["redundancy", "--csv"]) == 2
