"""The page and the terminal say which physics a run contains and which noise its records show."""

from reports.words.noise import lot_noise_sentence, noise_words
from reports.words.physics import RunPhysics, physics_sentences


def test_white_noise_is_not_mentioned():
    assert noise_words({"noise_colour": "white", "jitter_s": None}) == ""
    assert lot_noise_sentence(["white"] * 5, []) == ""


def test_identified_components_are_named_with_their_size():
    words = noise_words({"noise_colour": "coloured", "jitter_s": 3e-7, "error_all_noise": 1.004})
    assert "coloured" in words
    assert "300 ns" in words
    assert "1.0040" in words
    assert "sampling jitter in 2 of 5 devices (median 310 ns)" in lot_noise_sentence(["white"] * 5, [3.0e-7, 3.1e-7])


def test_the_head_states_what_is_carried_fitted_and_left_out():
    physics = RunPhysics(("offdiagonal_damping", "updown_tilt"), ("electrostatic_softening",), "ar", True)
    text = " ".join(physics_sentences(physics))
    assert "carry off-diagonal damping, up-down tilt, and autoregressive noise" in text
    assert "electrode mismatches" in text
    assert "not simulated: electrostatic softening" in text
    assert "carry" not in " ".join(physics_sentences(RunPhysics(mismatch=True)))
