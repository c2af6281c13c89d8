"""report.html: there after every run, whole, and true."""

import json
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import pytest

VOID = {"meta", "br", "link", "img", "input"}
LOST = (  # every body, soon and for good
    "table.mocap.dropout_rate=5", "table.mocap.dropout_s=100", "faults.pose_lost.above=0.5",
)  # fmt: skip


class Page(HTMLParser):
    """Tags must nest; text and addresses are kept."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.links: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href") and v]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def before_scrubber(page: str) -> str:
    """The page without its scrubber, which repeats the events."""
    return page.partition('<div id="scrub"')[0]


def read(folder: str = "out") -> tuple[str, str]:
    text = Path(folder, "report.html").read_text()
    return text, " ".join(Page(text).text)


def test_a_flight_of_the_paper(testbed):
    testbed("run", "zhang2023_table", "duration_s=4", "--out", "out")
    page, words = read()
    for said in ("failed: settled", "sotsmc", "SOTSMC", "danger radius 0.8 m", "Figure 15",
                 "Figure 16", "Figure 18", "testbed replay .", "numba", "not met",
                 "valves shut: no pose yet", "Flown 20", "; code ", "board firmware "):  # fmt: skip
        assert said in words, said
    assert Page(page).links == []  # nothing is fetched
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    drawn = {path.stem for path in Path("out/figures").iterdir()}
    assert drawn >= {"trajectory", "error", "error_xy", "tracking", "obstacles", "valves", "tank"}
    assert set(re.findall(r'<figure id="(\w+)"', page)) == drawn
    for path in Path("out/figures").iterdir():
        texts = [t.text for t in ET.parse(path).iter("{http://www.w3.org/2000/svg}text")]
        with_units = [t for t in texts if t and re.search(r"\[.+\]", t)]
        assert len(with_units) + ("vehicle and jet" in texts) >= 2, path


@pytest.mark.parametrize(
    ("experiment", "overrides"),
    [
        ("hold", ("criteria={}",)),
        ("hold", ("guidance.mode=wrench",)),
        ("xue2024_table_constant", ()),
        ("hold", LOST),
    ],
    ids=["passed", "wrench", "moving goal", "fault"],
)
def test_other_flights(testbed, experiment, overrides):
    testbed("run", experiment, "duration_s=2", *overrides, "--out", "out")
    page, words = read()
    assert experiment in words
    shown = re.sub(r"<(pre|script|style)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert not re.search(r"\bnan\b|[\d ,MLHV]nan", shown)


def test_an_older_run_gets_its_page_again(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "out")
    before = Path("out/report.html").read_text()
    Path("out/report.html").unlink()
    result = testbed("report", "out")
    assert result.exit_code == 0
    assert result.stdout == "out/report.html\n"
    assert Path("out/report.html").read_text() == before


def test_pictures_of_pixels(testbed):
    pytest.importorskip("resvg_py", reason="the figures extra is not installed")
    testbed("run", "hold", "duration_s=1", "--out", "out")
    assert testbed("report", "out", "--png").exit_code == 0
    for drawing in Path("out/figures").glob("*.svg"):
        assert drawing.with_suffix(".png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_run_without_metrics(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "out")
    Path("out/metrics.json").write_text("{}")
    assert "expected  the metrics of a run" in testbed("report", "out").stderr
    Path("out/metrics.json").unlink()
    assert testbed("report", "out").exit_code == 0
    assert "not judged, 0.9 s in the log" in read()[1]
    Path("out/log.mcap").unlink()
    result = testbed("report", "out")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")


def test_a_formation_is_judged_by_its_edges_and_not_by_goals(testbed):
    testbed("run", "xue2024_table_varying", "duration_s=6", "--out", "out")
    page, words = read()
    for said in ("Formation edges", "sat1, sat2", "sat3, leader", "formation settled",
                 "formation, error at the end", "longest edge", "boundary-layer"):  # fmt: skip
        assert said in words, said
    for said in ("hold RMS", "Distance to the goal", "Relative position error", "goal</th>"):
        assert said not in page, said
    assert "formation.error_m" not in words
    found = json.loads(Path("out/metrics.json").read_text())["formation"]
    assert f"{found['longest_edge_m']:.3g} m" in words
    assert f"{1e3 * found['error_m']:.3g} mm" in words


def test_why_a_flight_ended_is_among_the_events(testbed):
    assert testbed("run", "hold", "duration_s=4", *LOST, "--out", "out").exit_code == 3
    _, words = read()
    assert "aborted by a fault after" in words
    events = words[words.index("Faults and interventions") :]
    assert "warn: pose_stale" in events
    assert "brake: pose_missing, pose_lost" in events
    assert "fault: pose_lost: no pose for" in events
    assert "supervisor" in events


def test_events_of_many_vehicles_share_a_row(testbed):
    testbed("run", "zhang2023_table", "duration_s=1", "--out", "out")
    page, words = read()
    assert "sat1, sat2, sat3" in words
    assert before_scrubber(page).count("no pose yet") == 1


def test_nothing_is_drawn_of_what_was_not_measured(testbed):
    testbed("run", "hold", "duration_s=0.3", "--out", "out")
    page, words = read()
    assert 'id="tracking"' not in page
    assert "0.3 s" in words


def test_a_failure_is_told_from_its_beginning(testbed):
    """zhang2023_table_pd knows nothing of obstacles: it hits one, and the fault says so."""
    result = testbed("run", "zhang2023_table_pd", "duration_s=20", "--out", "out")
    assert result.exit_code == 3
    metrics = json.loads(Path("out/metrics.json").read_text())
    first = metrics["touches"][0]
    said = f"sat3 hit obstacle o1 at {first['t']:.1f} s, {100 * first['speed']:.0f} cm/s"
    assert len(metrics["touches"]) == metrics["contacts"] >= 1
    page, words = read()
    assert f'<div class="verdict fault">{said}; aborted by a fault after ' in page
    assert said in result.stdout
    told = words[words.index("Faults and interventions") :]
    contact = f"hit obstacle o1, {100 * first['speed']:.0f} cm/s"
    assert told.index(contact) < told.index("bumped")
    sentence = r"velocity jumped by 0\.\d+ m/s: contact with o1 \([\d.]+ cm away\)"
    assert len(re.findall(sentence, before_scrubber(page))) == 1  # said once
    for key in ("obstacles", "error", "speed"):  # and in the figures
        assert "sat3 hits o1" in Path(f"out/figures/{key}.svg").read_text(), key
    assert "Red stars are contacts" in words
    near = {n: v["min_obstacle_distance_m"] for n, v in metrics["vehicles"].items()}
    assert near["sat3"] < 0.8 < min(near["sat1"], near["sat2"])
    row = re.search(r"<tr><td>nearest obstacle \[m\].*?</tr>", page).group()
    assert row.count("missed") == 1
    assert f'<td class="missed">{near["sat3"]:.3f}</td>' in row
    assert re.search(r'<b class="missed">\d+ ?</b><span>contacts', page)


def test_a_criterion_that_is_missed_is_amber_and_marks_its_cells_only(testbed):
    words = ("duration_s=4", "criteria={max_contacts=0,impulse_ns=0.4}")
    testbed("run", "zhang2023_table", *words, "--out", "out")
    page, _ = read()
    assert '<div class="verdict failed">failed: impulse</div>' in page
    row = re.search(r"<tr><td>impulse \[N s\].*?</tr>", page).group()
    spent = [
        v["impulse_ns"]
        for v in json.loads(Path("out/metrics.json").read_text())["vehicles"].values()
    ]
    assert row.count("missed") == sum(one > 0.4 for one in spent)
    assert row.count("missed") > 0
    assert "<tr class" not in page


def test_every_page_of_a_twin_says_so(testbed):
    testbed("run", "hold", "duration_s=1", "--out", "out")  # fails: nothing settles in a second
    assert "Simulated on the twin, not flown on a table." in read()[1]
