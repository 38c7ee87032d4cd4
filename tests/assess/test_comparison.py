"""The notes below a comparison are about the methods in it."""

from certpgo.assess.comparison import METHODS, NOTES, notes


def test_notes_about_gtsam_need_its_rows():
    labels = [method.label for method in METHODS]
    assert notes(labels) == NOTES
    without_file = [label for label in labels if "file's" not in label]
    assert notes(without_file) == (*NOTES[:2], *NOTES[3:])
    assert notes(["certified", "newton"]) == (NOTES[0], NOTES[3])
