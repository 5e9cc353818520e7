"""mission.toml: every key that is unknown or wrong is refused with its line."""

from __future__ import annotations

from pathlib import Path

from nls.missions.scans import Drift
from nls.missions.scans.folder import Settings, read_settings
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases

TEXT = '# dive 3\n[sonar]\nazimuth = "right"\nx_m = 1\nyaw_rad = 0.1\n[drift]\nmean = 0.05\nheading = false\n'
EDITS = cases(r"""
[sonar] | [sonnar] | 2 | unknown section 'sonnar'; expected [sonar] and [drift]; did you mean 'sonar'?
[sonar]\n | sonar = 3\n[sonar]\n | 3 | is no TOML
x_m | xm | 4 | [sonar] has no 'xm'; expected azimuth, x_m, y_m, yaw_rad; did you mean 'x_m'?
mean | x_m | 7 | [drift] has no 'x_m'; expected mean, stretch, length, step, yaw, heading
"right" | "rigth" | 3 | azimuth is 'rigth'; expected the positive side, 'left' or 'right'; did you mean 'right'?
"right" | -1 | 3 | azimuth is -1; expected the positive side
x_m = 1 | x_m = "1" | 4 | x_m is '1'; expected a number, m, within 1000
x_m = 1 | x_m = nan | 4 | x_m is nan
0.1 | 30 | 5 | yaw_rad is 30; expected a number, rad
0.05 | -0.05 | 7 | mean is -0.05; expected a number from 1e-06 to 1000
0.05 | inf | 7 | mean is inf
0.05 | false | 7 | mean is False; expected a number from 1e-06 to 1000
false | true | 8 | heading is True; expected a number from 1e-06 to 1000, or false: no compass
0.05 | = | 7 | is no TOML
""")


def test_what_a_file_states_and_what_it_leaves_out(tmp_path: Path) -> None:
    file = tmp_path / "mission.toml"
    file.write_text(TEXT)
    assert read_settings(file) == Settings(-1.0, (1.0, 0.0, 0.1), Drift(mean=0.05, heading=None))
    file.write_text("")
    assert read_settings(file) == Settings()
    file.write_text("drift.yaw = 0.5")
    assert read_settings(file).drift.yaw == 0.5


@for_all(case=EDITS)
def test_a_wrong_key(case: list[str], tmp_path: Path) -> None:
    old, new, line, words = case
    file = tmp_path / "mission.toml"
    assert old in TEXT
    file.write_text(TEXT.replace(old, new, 1))
    assert_refused(int(line), words, read_settings, file)
