"""Work-precision diagrams: what is drawn is what was measured."""

from collections.abc import Iterator

import pytest
from written_runs import record

from sculpt_framework.comparison.diagrams import error_over_time, method_colors, time_to_error
from sculpt_framework.comparison.runs import CurvePoint, RunRecord
from sculpt_framework.evaluation.charts import COLORS
from sculpt_framework.evaluation.drawing import Drawing, Line, Path, Words

POWER = [(float(t), 0.04 / t**0.5) for t in (1, 4, 16)]
RECORDS = [
    record(POWER, method="a", seed=0),
    record([(t, 1.1 * e) for t, e in POWER], method="a", seed=1),
    record([(t, 0.9 * e) for t, e in POWER], method="a", seed=2),
    record([(t, 3 * e) for t, e in POWER], method="b"),
    record(POWER, method="b", scene="hammer"),
]


def texts(drawing: Drawing) -> list[str]:
    return [shape.text for shape in drawing.shapes if isinstance(shape, Words)]


def paths(drawing: Drawing) -> Iterator[Path]:
    return (shape for shape in drawing.shapes if isinstance(shape, Path))


def test_a_panel_a_scene_a_colour_a_method_and_a_thick_line_for_the_median():
    drawing = error_over_time(RECORDS, "chamfer", "train")
    assert drawing is not None
    shown = texts(drawing)
    for text in ("Chamfer distance against time", "a", "b", "jar", "hammer"):
        assert text in shown
    assert shown.count("training time, s (log)") == 2
    assert shown.count("Chamfer distance, scene units (log)") == 2
    thick = [path for path in paths(drawing) if path.width > 2]
    assert [path.color for path in thick] == [COLORS[0], COLORS[1], COLORS[1]]
    assert sum(path.width == 1 for path in paths(drawing)) == 5


def test_the_median_line_lies_on_the_middle_run():
    drawing = error_over_time(RECORDS[:3], "chamfer", "train")
    assert drawing is not None
    (median,) = [path for path in paths(drawing) if path.width > 2]
    thin = [path for path in paths(drawing) if path.width == 1]
    assert [y for _, y in median.points] == pytest.approx([y for _, y in thin[0].points])
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(median.points[:-1], median.points[1:], strict=True)]
    assert slopes == pytest.approx([slopes[0]] * len(slopes)), "a power law is straight"


def test_the_two_diagrams_tell_the_same():
    """A power law is straight in both, and where one falls the other does: less error takes longer."""
    drawing = time_to_error(RECORDS[:1], "chamfer", "train")
    assert drawing is not None
    assert "Time until the Chamfer distance is at most" in texts(drawing)
    (median,) = [path for path in paths(drawing) if path.width > 2]
    slopes = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(median.points[:-1], median.points[1:], strict=True)]
    assert slopes == pytest.approx([slopes[0]] * len(slopes), rel=1e-6)
    assert slopes[0] > 0, "downwards is less time"


def test_a_failure_is_crossed_where_its_lines_end():
    drawing = error_over_time([record(POWER, failed=True)], "chamfer", "train")
    assert drawing is not None
    arms = [shape for shape in drawing.shapes if isinstance(shape, Line) and shape.color == COLORS[0]]
    assert len(arms) == 2
    ends = [path.points[-1] for path in paths(drawing)]
    middles = [(0.5 * (arm.start[0] + arm.end[0]), 0.5 * (arm.start[1] + arm.end[1])) for arm in arms]
    assert ends == middles
    assert time_to_error([record(POWER, failed=True), record(POWER, failed=True)], "chamfer", "train") is not None


def test_a_mesh_of_unknown_time_is_a_dashed_line_across():
    timed = RunRecord(name="t", scene="jar", method="t", final={"chamfer_ps": 0.02, "t_train_s": 5.0})
    untimed = RunRecord(name="u", scene="jar", method="u", final={"chamfer_ps": 0.02})
    drawing = error_over_time([*RECORDS, timed, untimed], "chamfer", "train")
    assert drawing is not None
    (level,) = [shape for shape in drawing.shapes if isinstance(shape, Line) and shape.dash]
    assert level.color == method_colors([*RECORDS, timed, untimed])["u"]
    assert level.start[1] == level.end[1]
    axis = [shape for shape in drawing.shapes if isinstance(shape, Line) and not shape.dash]
    assert level.end[0] - level.start[0] == max(line.end[0] - line.start[0] for line in axis)


def test_a_score_has_a_plain_axis():
    curve = tuple(CurvePoint(train_seconds=t, psnr=p) for t, p in ((1.0, 20.0), (4.0, 30.0)))
    run = RunRecord(name="r", scene="s", method="m", curve=curve, final={"psnr": 30.0})
    drawing = time_to_error([run], "psnr", "train")
    assert drawing is not None
    assert "PSNR on held-out views, dB" in texts(drawing)
    assert "Time until the PSNR on held-out views is at least" in texts(drawing)


def test_nothing_known_is_no_diagram():
    assert error_over_time(RECORDS, "iou", "train") is None
    assert time_to_error(RECORDS, "iou", "train") is None
