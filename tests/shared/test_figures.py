"""The line under every figure, and figures without a clock."""

from matplotlib.figure import Figure

from shared.figures import footer, save


def drawn(path, attributes):
    figure = Figure(figsize=(3, 2))
    figure.subplots().plot([0, 1], [0, 1])
    save(figure, path, attributes)
    return path.read_bytes()


def test_the_footer_says_what_a_picture_rests_on():
    line = footer({"simulated": True, "simulated_share": 0.25, "oldest_input": "2026-01-01", "code_version": "v"})
    assert line == "SIMULATED input (25 %) · oldest input 2026-01-01 · code v"
    assert footer({"code_version": "v", "model_version": "m"}).startswith(
        "no simulated input · oldest input not stated"
    )


def test_a_simulated_figure_is_marked_and_the_same_twice(tmp_path):
    simulated = {"simulated": True, "simulated_share": 1.0, "code_version": "v"}
    first, second = drawn(tmp_path / "a.png", simulated), drawn(tmp_path / "b.png", simulated)
    assert first == second
    assert first != drawn(tmp_path / "c.png", {**simulated, "simulated": False})
