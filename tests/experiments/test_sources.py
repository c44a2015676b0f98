import pandas as pd
import sources

SETS = {"kitchen": ("room-0 room-1", "room-0 garden"), "room": ("kitchen garden", "kitchen garden")}


def rows():
    """Networks of two hosts, scored on two sources; on the kitchen, of one and of two scenes."""
    return pd.DataFrame(
        [
            {"source": source, "method": "removal", "seed": 0, "hosts": 2, "names": names, "auc": x}
            for source, sets in SETS.items()
            for names, x in zip(sets, (0.7, 0.9), strict=True)
        ]
    )


def test_captures_of_a_scene_count_as_one_scene():
    text = sources.report(rows())
    assert "| hosts | 1 scene | 2 scenes |" in text
    assert "| 2 | 0.700 (1, 1) | 0.833 (3, 2) |" in text
    assert "| 4 | - | - |" in text


def test_sets_are_compared_on_the_same_source_where_their_scenes_differ_in_number():
    text = sources.report(rows())
    assert "| 2 | kitchen | 1: 0.700 | 2: 0.900 | +0.200 |" in text
    assert "| 2 | room |" not in text
