"""Small tables as loggers and programs write them, and what is to be read of each.

Headers follow the programs' own documentation and files that people have published: Vernier's
Logger Pro, Graphical Analysis and Video Analysis, PASCO's Capstone and SPARKvue, phyphox, Tracker,
DeepLabCut, Excel in German, French, Spanish and Italian, numpy, Arduino. The half that is called
``SET_ASIDE`` was written and committed before the reader was changed for the other half.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import numpy as np

T = np.round(0.05 * np.arange(8), 10)
FALL = np.round(2 - 4.905 * T**2, 6)
SPRING = np.round(0.25 + 0.1 * np.cos(6 * T), 6)
ACROSS = np.round(1.5 * T, 6)
OBJECT = "object"
EASTWARD, NORTHWARD = 74_625.3536, 111_190.3226
"""A degree at 48 degrees north, m: a cos(phi) / (1 - e^2 sin^2 phi)^(1/2) times pi / 180, and along
the meridian a (1 - e^2) / (1 - e^2 sin^2 phi)^(3/2) times that."""
END = "***End_of_Header***"
LVM = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2"]
SEGMENT = ["Channels\t1", "X_Dimension\tTime", "X0\t0,0E+0", "Delta_X\t0,05", END,
           "X_Value\tPosition (m)\tComment"]  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """A file, how it is opened, and what is to come of it.

    `tracks` maps (scene, entity) to times, x and y in SI (None: nothing moves there); a scene of
    None is called after the file. `refused` are words of the complaint; `told` are words of notes.
    """

    name: str
    content: bytes
    tracks: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)
    up: str | None = None
    told: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()


def table(header, *columns, sep=",", decimal=".", end="\n", form="{:.6f}", quoted=False):
    """Text of a table; a cell of a column that is None or shorter than the others is blank."""
    lines = header if isinstance(header, list) else [header]
    for k in range(max(len(column) for column in columns)):
        cells = [column[k] if k < len(column) else "" for column in columns]
        cells = [c if isinstance(c, str) else form.format(c).replace(".", decimal) for c in cells]
        lines = [*lines, sep.join(f'"{c}"' if quoted else c for c in cells)]
    return end.join(lines) + end


def twice(x, y):
    """A track of 10 rows whose second differences are accelerations: it is at rest before."""
    t = 0.05 * np.arange(-1, 9)
    places = [np.cumsum(np.cumsum(np.r_[0.0, 0.0, 0.05**2 * a])) for a in (x, y)]
    return {(None, OBJECT): (t, *(own - own.mean() for own in places))}


def workbook(rows):
    """Bytes of an Excel workbook of one sheet; b"" where openpyxl is not installed."""
    try:
        import openpyxl
    except ImportError:
        return b""
    book, out = openpyxl.Workbook(), io.BytesIO()
    for row in rows:
        book.active.append([None if cell is None else cell for cell in row])
    book.save(out)
    return out.getvalue()


def spreadsheet(columns):
    """Bytes of an OpenDocument spreadsheet; b"" where nothing is installed that writes one."""
    import pandas as pd

    out = io.BytesIO()
    try:
        pd.DataFrame(columns).to_excel(out, engine="odf", index=False)
    except ImportError:
        return b""
    return out.getvalue()


def parquet(columns):
    """Bytes of a Parquet file; b"" where nothing is installed that writes one."""
    import pandas as pd

    out = io.BytesIO()
    try:
        pd.DataFrame(columns).to_parquet(out)
    except ImportError:
        return b""
    return out.getvalue()


def one(x=None, y=None, *, scene=None, entity=OBJECT, t=T):
    return {(scene, entity): (t, x, y)}


LOOKED_AT = {
    "vernier": Sample("fall.csv", table(
        '"Latest: Time (s)","Latest: Position (m)","Latest: Velocity (m/s)"', T, FALL, -9.81 * T,
    ).encode(), one(x=FALL), told=("Position",)),
    "graphical analysis, two runs": Sample("cart.csv", table(
        "Data Set 1:Time(s),Data Set 1:Position(m),Data Set 2:Time(s),Data Set 2:Position(m)",
        T, SPRING, T[:5], ACROSS[:5],
    ).encode(), one(x=SPRING, scene="Data Set 1")
        | one(x=ACROSS[:5], scene="Data Set 2", t=T[:5])),
    "capstone, runs side by side": Sample("spring.csv", table(
        "Time (s) Run #1,Position (m) Run #1,Time (s) Run #2,Position (m) Run #2",
        T, SPRING, T, ACROSS,
    ).encode(), one(x=SPRING, scene="Run #1") | one(x=ACROSS, scene="Run #2")),
    "pasco, a row of runs on top": Sample("spring.csv", table(
        ["Run #1,Run #1,Run #2,Run #2", "Time (s),Position (m),Time (s),Position (m)"],
        T, SPRING, T, ACROSS,
    ).encode(), one(x=SPRING, scene="Run #1") | one(x=ACROSS, scene="Run #2")),
    "excel, german": Sample("Fall.csv", table(
        "Zeit (s);Höhe (m)", T, FALL, sep=";", decimal=",", end="\r\n",
    ).encode("cp1252"), one(y=FALL), up="y", told=("Höhe", "1252")),
    "excel, french": Sample("chute.csv", table(
        "Essai;Temps (s);Hauteur (cm)", ["1"] * 8 + ["2"] * 8, [*T, *T],
        [*100 * FALL, *100 * SPRING], sep=";", decimal=",", end="\r\n",
    ).encode("cp1252"), one(y=FALL, scene="1") | one(y=SPRING, scene="2"), up="y",
        told=("Essai", "Hauteur")),
    "phyphox, acceleration": Sample("Raw Data.csv", table(
        '"Time (s)","Linear Acceleration x (m/s^2)","Linear Acceleration y (m/s^2)",'
        '"Linear Acceleration z (m/s^2)","Absolute acceleration (m/s^2)"',
        T, ACROSS, 2 * ACROSS, SPRING, FALL, form="{:.9E}",
    ).encode(), twice(ACROSS, 2 * ACROSS), told=("sums of accelerations",)),
    "tracker, two masses pasted": Sample("pasted.txt", table(
        ["mass A\t\t\tmass B\t\t", "t\tx\ty\tt\tx\ty"], T, ACROSS, FALL, T, SPRING, ACROSS,
        sep="\t",
    ).encode(), one(ACROSS, FALL, entity="mass A") | one(SPRING, ACROSS, entity="mass B")),
    "a double star, wide, by date": Sample("star.csv", table(
        "date,star1_x,star1_y,star2_x,star2_y",
        [f"2020-01-{k + 1:02d}T12:00:00" for k in range(8)], ACROSS, FALL, SPRING, -FALL,
    ).encode(), {
        (None, "star1"): (86400.0 * np.arange(8), ACROSS, FALL),
        (None, "star2"): (86400.0 * np.arange(8), SPRING, -FALL),
    }, options={"units": {"length": "m"}}, told=("2020-01-01", "star1")),
    "workbook": Sample("fall.xlsx", workbook(
        [["Fall of a ball", None], ["Time (s)", "Height (cm)"],
         *([t, h] for t, h in zip(T.tolist(), (100 * FALL).tolist(), strict=True))]
    ), one(y=FALL), up="y", told=("Height",)),
    "parquet": Sample("tracks.parquet", parquet(
        {"time": T, "pos_x": ACROSS, "pos_y": FALL, "object": ["ball"] * 8}
    ), one(ACROSS, FALL, entity="ball", scene=None)),
    "logger pro, text": Sample("run.txt", table(
        ["Vernier Format 2", "untitled.cmbl 11/3/2009 10:53:01 .", "Run 1", "Time\tPosition",
         "t\tx", "s\tcm", ""], T, 100 * SPRING, sep="\t",
    ).encode(), one(x=SPRING, scene="Run 1")),
    "trials below each other": Sample("throws.csv", table(
        "trial,time_s,height_m", ["a"] * 8 + ["b"] * 8, [*T, *T], [*FALL, *SPRING],
    ).encode(), one(y=FALL, scene="a") | one(y=SPRING, scene="b"), up="y", told=("trial",)),
    "Versuche, units in words": Sample("wagen.csv", table(
        "\ufeffVersuch;Zeit [Sekunden];Weg [Zentimeter]", ["1"] * 8 + ["2"] * 8, [*T, *T],
        [*100 * ACROSS, *100 * SPRING], sep=";", decimal=",",
    ).encode(), one(x=ACROSS, scene="1") | one(x=SPRING, scene="2"), told=("Weg", "Versuch")),
    "two positions": Sample("carts.csv", table(
        '"Time (s)","Position 1 (m)","Position 2 (m)"', T, SPRING, ACROSS,
    ).encode(), one(x=SPRING, entity="1") | one(x=ACROSS, entity="2"), told=("Position 1",)),
}

SET_ASIDE = {
    "logger pro, runs side by side": Sample("runs.csv", table(
        '"Run 1: Time (s)","Run 1: Position (m)","Run 2: Time (s)","Run 2: Position (m)"',
        T, SPRING, T[:6], ACROSS[:6],
    ).encode(), one(x=SPRING, scene="Run 1") | one(x=ACROSS[:6], scene="Run 2", t=T[:6])),
    "video analysis": Sample("throw.csv", table(
        '"Video Analysis: Time (s)","Video Analysis: X (m)","Video Analysis: Y (m)",'
        '"Video Analysis: X Velocity (m/s)","Video Analysis: Y Velocity (m/s)"',
        T, ACROSS, FALL, 1.5 + 0 * T, -9.81 * T,
    ).encode(), one(ACROSS, FALL)),
    "capstone, decimal comma": Sample("feder.csv", table(
        "\ufeffTime (s) Run #1;Position (m) Run #1;Velocity (m/s) Run #1", T, SPRING, T, sep=";",
        decimal=",",
    ).encode(), one(x=SPRING, scene="Run #1")),
    "sparkvue": Sample("cart.csv", table(
        '"Date and Time Run 1","Time (s) Run 1","Position (m) Run 1"',
        [f"11/3/2023 10:53:0{k} AM" for k in range(8)], T, SPRING,
    ).encode(), one(x=SPRING, scene="Run 1")),
    "phyphox, distance": Sample("lidar.csv", table(
        '"Time (s)";"Distance (m)"', T, SPRING, sep=";", decimal=",", form="{:.9E}",
    ).encode(), one(x=SPRING), told=("Distance",)),
    "phyphox, location": Sample("balloon.csv", table(
        '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)","Direction (°)",'
        '"Horizontal Accuracy (m)","Vertical Accuracy (m)"',
        T, 48 + 0 * T, 9 + 0 * T, FALL, 0 * T, 0 * T, 5 + 0 * T, 8 + 0 * T,
    ).encode(), one(y=FALL), up="y", told=("Latitude", "Height")),
    "tracker, german": Sample("kugel.txt", table(
        ["Masse_A", "t\tx\ty\tv"], T, ACROSS, FALL, T, sep="\t", decimal=",", form="{:.5E}",
    ).encode(), one(ACROSS, FALL, entity="Masse_A")),
    "deeplabcut": Sample("mouse.csv", table(
        ["scorer,net,net,net,net,net,net", "bodyparts,nose,nose,nose,tail,tail,tail",
         "coords,x,y,likelihood,x,y,likelihood"],
        [str(k) for k in range(8)], ACROSS, FALL, 0.9 + 0 * T, SPRING, ACROSS, 0.9 + 0 * T,
    ).encode(), one(ACROSS, FALL, entity="nose") | one(SPRING, ACROSS, entity="tail"),
        options={"fps": 20}),
    "numpy": Sample("track.txt", table(
        "# t x y", T, ACROSS, FALL, sep=" ", form="{:.18e}",
    ).encode(), one(ACROSS, FALL)),
    "excel, italian": Sample("carrello.csv", table(
        ["sep=;", "Prova;Tempo (s);Posizione (cm)"], ["1"] * 8 + ["2"] * 8, [*T, *T],
        [*100 * ACROSS, *100 * SPRING], sep=";", decimal=",", end="\r\n",
    ).encode("cp1252"), one(x=ACROSS, scene="1") | one(x=SPRING, scene="2"),
        told=("Posizione", "Prova")),
    "excel, spanish": Sample("tiro.txt", table(
        "Tiempo (s)\tPosición x (cm)\tPosición y (cm)", T, 100 * ACROSS, 100 * FALL, sep="\t",
        decimal=",", end="\r\n",
    ).encode("cp1252"), one(ACROSS, FALL), told=("1252",)),
    "workbook, runs side by side": Sample("Wagen.xlsx", workbook(
        [["Lauf 1", None, "Lauf 2", None], ["Zeit in s", "Weg in cm", "Zeit in s", "Weg in cm"],
         *([t, a, t, b] for t, a, b in zip(
             T.tolist(), (100 * SPRING).tolist(), (100 * ACROSS).tolist(), strict=True))]
    ), one(x=SPRING, scene="Lauf 1") | one(x=ACROSS, scene="Lauf 2")),
    "arduino": Sample("sonar.csv", table(
        "time_ms, distance_cm", 1000 * T, 100 * SPRING, sep=", ",
    ).encode(), one(x=SPRING), told=("distance",)),
    "numbered bodies": Sample("discs.csv", table(
        "frame,x1,y1,x2,y2", [str(k) for k in range(8)], ACROSS, FALL, SPRING, ACROSS,
    ).encode(), one(ACROSS, FALL, entity="1") | one(SPRING, ACROSS, entity="2"),
        options={"fps": 20}, told=("x1",)),
    "channels": Sample("scope.csv", table(
        "Kanal A;Kanal B", T, SPRING, sep=";", decimal=",",
    ).encode(), refused=("Kanal A", "--columns t=")),
}  # fmt: skip

AU = 149597870700.0
TURN = np.round(np.cos(6 * T), 6)
YEARS = 365.25 * 86400 * (np.arange(8) + 2000.5)
LATER = {
    "rotary motion sensor of vernier": Sample("pendulum.csv", table(
        '"Latest: Time (s)","Latest: Angle (rad)","Latest: Velocity (rad/s)"', T, TURN, -TURN,
    ).encode(), one(x=TURN), told=("Angle",)),
    "rotary motion sensor of pasco, degrees": Sample("pendulum.csv", table(
        "Time (s) Run #1;Angle (°) Run #1;Angular Velocity (°/s) Run #1", T, np.degrees(TURN), T,
        sep=";", decimal=",",
    ).encode(), one(x=TURN, scene="Run #1"), told=("Angle",)),
    "measures of a double star": Sample("stf60.csv", table(
        "epoch,rho (arcsec),theta (deg)", [f"{2000 + k}.5" for k in range(8)], 1 + T,
        np.degrees(TURN),
    ).encode(), one((1 + T) * np.sin(TURN), (1 + T) * np.cos(TURN), t=YEARS, entity="companion")
        | one(0 * T, t=YEARS, entity="primary"), told=("rho", "theta", "decimal years", "primary")),
    "libreoffice": Sample("fall.ods", spreadsheet({"Zeit (s)": T, "Höhe (cm)": 100 * FALL}),
                          one(y=FALL), up="y", told=("Höhe",)),
    "tracker, commas": Sample("ball.csv", table(
        ['"mass A",,', '"t","x","y"'], T, ACROSS, FALL,
    ).encode(), one(ACROSS, FALL, entity="mass A")),
    "trackmate": Sample("spots.csv", table(
        ["LABEL,TRACK_ID,POSITION_X,POSITION_Y,POSITION_T,FRAME",
         "Label,Track ID,X,Y,T,Frame", "Label,Track ID,X,Y,T,Frame",
         ",,(micron),(micron),(sec),"],
        [f"ID{k}" for k in range(8)], ["0"] * 8, ACROSS, FALL, T, [str(k) for k in range(8)],
    ).encode(), one(1e-6 * ACROSS, 1e-6 * FALL, entity="0"), told=("TRACK_ID",)),
    "trackpy": Sample("tracks.csv", table(
        ",y,x,mass,size,ecc,signal,raw_mass,ep,frame,particle", [str(k) for k in range(8)],
        FALL, ACROSS, 100 + T, 3 + T, 0.1 + T, T, T, 0.02 + 0 * T, [str(k) for k in range(8)],
        ["0"] * 8,
    ).encode(), one(ACROSS, FALL, entity="0"), options={"fps": 20}),
    "labquest": Sample("cart.txt", table(
        "Run 1: Time (s)\tRun 1: Distance (m)\tRun 2: Time (s)\tRun 2: Distance (m)",
        T, SPRING, T, ACROSS, sep="\t",
    ).encode(), one(x=SPRING, scene="Run 1") | one(x=ACROSS, scene="Run 2")),
    "go direct, a run in the name": Sample("cart.csv", table(
        "Time(s) Run 1,Position(m) Run 1", T, SPRING,
    ).encode(), one(x=SPRING, scene="Run 1")),
    "sleap": Sample("mice.csv", table(
        "track,frame_idx,instance.score,nose.x,nose.y,nose.score,tail.x,tail.y,tail.score",
        ["track_0"] * 8, [str(k) for k in range(8)], 0.9 + 0 * T, ACROSS, FALL, 0.9 + 0 * T,
        SPRING, ACROSS, 0.9 + 0 * T,
    ).encode(), one(ACROSS, FALL, entity="nose") | one(SPRING, ACROSS, entity="tail"),
        options={"fps": 20}),
    "horizons": Sample("mars.txt", table(
        ["*" * 79, "Ephemeris / API_USER Tue Nov 24 2026", "Target body name: Mars (499)",
         "Output units    : AU-D", "*" * 79,
         "            JDTDB,            Calendar Date (TDB),              X,              Y,"
         "              Z,", "*" * 79, "$$SOE"],
        [f"{2451545.0 + k:.9f}" for k in range(8)],
        [f" A.D. 2000-Jan-{k + 1:02d} 12:00:00.0000" for k in range(8)],
        ACROSS, FALL, SPRING, [""] * 8, form="{:23.15E}",
    ).encode() + b"$$EOE\n" + b"*" * 79 + b"\n", {(None, "Mars"): (
        86400 * (2451545.0 + np.arange(8)), AU * ACROSS, AU * FALL)}),
    "gps": Sample("glider.csv", table(
        "time,lat,lon,ele", [f"2024-05-04T10:00:0{k}Z" for k in range(8)], 48 + 2e-5 * T,
        9 + 2e-5 * T, 100 * FALL,
    ).encode(), one(2e-5 * T * EASTWARD, 2e-5 * T * NORTHWARD, t=np.arange(8.0)), up="z",
        told=("WGS 84", "'ele' as the height")),
    "kinovea": Sample("jump.csv", table(
        "Time (ms);Trajectory 1 X (m);Trajectory 1 Y (m)", 1000 * T, ACROSS, FALL, sep=";",
        decimal=",",
    ).encode(), one(ACROSS, FALL, entity="Trajectory 1")),
    "two angles": Sample("double.csv", table(
        "t (s),theta1 (rad),theta2 (rad)", T, TURN, SPRING,
    ).encode(), one(x=TURN, entity="theta1") | one(x=SPRING, entity="theta2"), told=("theta1",)),
    "datastudio": Sample("cart.txt", table(
        ["Position, Ch 1&2, Run #1", "Time ( s )\tPosition ( m )"], T, SPRING, sep="\t",
    ).encode(), one(x=SPRING, scene="Run #1")),
}  # fmt: skip
"""Of another day, and written before any of them was tried."""

A_LINE = "Versuch Nr.;Zeit in s;Weg in cm;Höhe in cm"
MORE = {
    "tracker, masses as subscripts": Sample("pucks.txt", table(
        "t\tx_{Puck A}\ty_{Puck A}\tx_{Puck B}\ty_{Puck B}", T, ACROSS, FALL, SPRING, ACROSS,
        sep="\t",
    ).encode(), one(ACROSS, FALL, entity="Puck A") | one(SPRING, ACROSS, entity="Puck B"),
        options={"units": {"length": "m", "time": "s"}}),
    "ethovision": Sample("Raw data-Trial     1.txt", table(
        ['"Number of header lines:";"6"', '"Trial name";"Trial     1"', '"Arena name";"Centre"',
         '"Start time";"2023-05-09 10:10:22.480"', '"Trial time";"Recording time";"X center";'
         '"Y center"', '"s";"s";"cm";"cm"'],
        T + 1, T, 100 * ACROSS, 100 * FALL, sep=";",
    ).replace("\n", "\r\n").encode("utf-16"), one(ACROSS, FALL),
        options={"columns": {"t": "Recording time", "x": "X center", "y": "Y center"}}),
    "trackmate, all its columns": Sample("spots.csv", table(
        ["LABEL,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_T,FRAME,MEAN_INTENSITY_CH1",
         "Label,Track ID,Quality,X,Y,T,Frame,Mean intensity ch1",
         "Label,Track ID,Quality,X,Y,T,Frame,Mean ch1",
         ",,(quality),(mm),(mm),(sec),,(counts)"],
        [f"ID{k}" for k in range(8)], ["0"] * 8, 20 + T, 1000 * ACROSS, 1000 * FALL, T,
        [str(k) for k in range(8)], 170 + T,
    ).encode(), one(ACROSS, FALL, entity="0"), options={"columns": {
        "body": "TRACK_ID", "t": "POSITION_T", "x": "POSITION_X", "y": "POSITION_Y"}}),
    "qualisys, columns by its names": Sample("clear.tsv", table(
        ["NO_OF_FRAMES\t8", "NO_OF_MARKERS\t1", "FREQUENCY\t100", "DESCRIPTION\t--",
         "DATA_INCLUDED\t3D", "MARKER_NAMES\tcork", "TRAJECTORY_TYPES\tMeasured",
         "Frame\tTime\tcork X\tcork Y\tcork Z"],
        [str(k) for k in range(8)], T, 1000 * ACROSS, 1000 * FALL, 1000 * SPRING, sep="\t",
    ).encode(), one(ACROSS, FALL), options={
        "columns": {"t": "Time", "x": "cork X", "y": "cork Y", "z": "cork Z"},
        "units": {"length": "mm", "time": "s"}}),
    "stk": Sample("probe.csv", table(
        '"Time (UTCG)","x (km)","y (km)","z (km)"',
        [f"18 Mar 2024 02:14:{30 + k}.000" for k in range(8)], ACROSS, FALL, SPRING,
    ).encode(), {(None, "object"): (np.arange(8.0), 1000 * ACROSS, 1000 * FALL)}),
    "deeplabcut, several animals": Sample("dish.csv", table(
        ["scorer,net,net,net,net,net,net", "individuals,red,red,red,black,black,black",
         "bodyparts,centre,centre,centre,centre,centre,centre",
         "coords,x,y,likelihood,x,y,likelihood"],
        [str(k) for k in range(8)], ACROSS, FALL, 0.9 + 0 * T, SPRING, ACROSS, 0.9 + 0 * T,
    ).encode(), one(ACROSS, FALL, entity="red") | one(SPRING, ACROSS, entity="black"),
        options={"fps": 20}),
    "two angles in several runs": Sample("gekoppelt.csv", table(
        '"Zeit (s) Lauf #1";"Winkel A (rad) Lauf #1";"Winkel B (rad) Lauf #1";'
        '"Zeit (s) Lauf #2";"Winkel A (rad) Lauf #2";"Winkel B (rad) Lauf #2"',
        T, TURN, SPRING, T, SPRING, TURN, sep=";", decimal=",",
    ).encode(), one(x=TURN, scene="Lauf #1", entity="Winkel A")
        | one(x=SPRING, scene="Lauf #1", entity="Winkel B")
        | one(x=SPRING, scene="Lauf #2", entity="Winkel A")
        | one(x=TURN, scene="Lauf #2", entity="Winkel B")),
    "a pose of ros": Sample("quad.csv", table(
        "Time,header.seq,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,"
        "pose.orientation.y,pose.orientation.z,pose.orientation.w",
        T, [str(k) for k in range(8)], ACROSS, FALL, SPRING, 0 * T, 0 * T, 0 * T, 0 * T + 1,
    ).encode(), one(ACROSS, FALL, entity="pose.position")),
    "an angle by its name": Sample("metronome.csv", table(
        ["#Kinovea Angle tracking export", "#Video: small.mp4  30.00 fps",
         "Time (ms);Angle (deg)"], 1000 * T, np.degrees(TURN), sep=";",
    ).encode(), one(x=TURN), options={"columns": {"t": "Time (ms)", "theta": "Angle (deg)"}}),
    "capstone, runs after a comma": Sample("spring.csv", table(
        '"Time (s), Run #1","Position (m), Run #1","Time (s), Run #2","Position (m), Run #2"',
        T, SPRING, T, ACROSS,
    ).encode(), one(x=SPRING, scene="Run #1") | one(x=ACROSS, scene="Run #2")),
    "numbered trials of a German Excel": Sample("wurf.csv", table(
        A_LINE, ["1"] * 8 + ["2"] * 8, [*T, *T], [*100 * ACROSS, *100 * SPRING],
        [*100 * FALL, *100 * FALL], sep=";", decimal=",", end="\r\n",
    ).encode("cp1252"), one(ACROSS, FALL, scene="1") | one(SPRING, FALL, scene="2"), up="y",
        told=("Versuch Nr.", "1252")),
    "components of a double star": Sample("stars.csv", table(
        "Date,A_x [AU],A_y [AU],B_x [AU],B_y [AU]", [f"2020-01-{k + 1:02d}" for k in range(8)],
        ACROSS, FALL, SPRING, -FALL,
    ).encode(), {
        (None, "A"): (86400.0 * np.arange(8), AU * ACROSS, AU * FALL),
        (None, "B"): (86400.0 * np.arange(8), AU * SPRING, -AU * FALL),
    }, told=("A_x",)),
    "accelerations by their letter": Sample("shake.csv", table(
        "t,A_x,A_y", T, ACROSS, FALL,
    ).encode(), refused=("accelerations (A_x, A_y)",)),
    "forces by their letter": Sample("pulls.csv", table(
        "t,F_x,F_y", T, ACROSS, FALL,
    ).encode(), refused=("no column 'x'", "F_x")),
    "a height by its letter": Sample("fall.xlsx", workbook(
        [["t / s", "h / cm"], *([t, h] for t, h in zip(
            T.tolist(), (100 * FALL).tolist(), strict=True))]
    ), one(y=FALL), up="y", told=("h / cm",)),
    "units in angle brackets and braces": Sample("throw.csv", table(
        "time <ms>;pos.x {mm};pos.y {mm}", 1000 * T, 1000 * ACROSS, 1000 * FALL, sep=";",
    ).encode(), one(ACROSS, FALL)),
    "units after a dash": Sample("cart.csv", table(
        "Elapsed time - s,Displacement - cm", T, 100 * SPRING,
    ).encode(), one(x=SPRING), told=("Displacement",)),
    "labview": Sample("spring.lvm", table(
        [*LVM, "Separator\tTab", "X_Columns\tOne", END, "\t\t", "Channels\t1\t",
         "Y_Unit_Label\tcm\t", "X_Dimension\tTime\t", "X0\t0.0E+0\t", "Delta_X\t0.05\t", END,
         "X_Value\tPosition\tComment"], T, 100 * SPRING, sep="\t",
    ).encode(), one(x=SPRING), told=("Position (cm)",)),
    "labview, segments without times": Sample("spring.lvm", table(
        [*LVM, "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tNo", END, *SEGMENT],
        [""] * 8, SPRING, sep="\t", decimal=",",
    ).encode() + table(["", *SEGMENT], [""] * 8, ACROSS, sep="\t", decimal=",").encode(),
        one(x=SPRING, scene="1") | one(x=ACROSS, scene="2")),
    "labview, times of every channel": Sample("table.lvm", table(
        [*LVM, "Separator\tComma", "X_Columns,Multi", END, "Channels,2", "X0,0.0,0.0", END,
         "X_Value,x (m),X_Value,y (m),Comment"], T, ACROSS, T, FALL,
    ).encode(), one(ACROSS, FALL)),
    "an unknown word with a unit of time": Sample("heave.txt", table(
        "Abscissa (s)\tHeave (mm)", T, 1000 * SPRING, sep="\t",
    ).encode(), one(x=SPRING), told=("'Abscissa (s)' as t", "'Heave (mm)' as x")),
    "a map": Sample("gps.csv", table(
        "run,time_s,easting_m,northing_m", ["1"] * 8, T, ACROSS, FALL,
    ).encode(), one(ACROSS, FALL, scene="1"), told=("'northing_m' as y",)),
    "runs that no heading tells": Sample("two.csv", table(
        "Zeit in s;Weg in cm", [*T, *T], [*100 * ACROSS, *100 * SPRING], sep=";", decimal=",",
    ).encode(), one(x=ACROSS, scene="part 1") | one(x=SPRING, scene="part 2"),
        told=("clock begins anew in line 10",)),
}  # fmt: skip
"""What a new user's files of a third day were not read, or refused without the option."""
