"""Tables of further programs, written after their documentation before any of them was tried.

Motion capture (Qualisys, OptiTrack, Vicon, TRC, DLTdv), loggers (Vernier's text format, Campbell,
CASSY, a MicroPython board), ImageJ, MATLAB, Julian dates. Four of these fifteen were read, or
refused with the option that helps, before the reader was changed.
"""

from __future__ import annotations

import numpy as np

from tests.logger_tables import (
    ACROSS,
    AU,
    FALL,
    OBJECT,
    SPRING,
    Sample,
    T,
    one,
    table,
    twice,
)

COUNT = [str(k + 1) for k in range(8)]
NONE, STILL = ["0"] * 8, ["-1"] * 8

CAPTURES = {
    "qualisys": Sample("throw.tsv", table(
        ["NO_OF_FRAMES\t8", "NO_OF_CAMERAS\t6", "NO_OF_MARKERS\t1", "FREQUENCY\t20",
         "NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--",
         "TIME_STAMP\t2025-11-24, 10:12:01.123\t1234.56789", "DATA_INCLUDED\t3D",
         "MARKER_NAMES\tball", "Frame\tTime\tball X\tball Y\tball Z"],
        COUNT, T, 1000 * ACROSS, 1000 * SPRING, 1000 * FALL, sep="\t",
    ).encode(), one(ACROSS, SPRING, entity="ball"),
        options={"units": {"length": "mm", "time": "s"}}),
    "motive": Sample("Take.csv", table(
        ["Format Version,1.23,Take Name,Take 2025-11-24,Capture Frame Rate,20.000000,Export Frame "
         "Rate,20.000000,Rotation Type,XYZ,Length Units,Meters,Coordinate Space,Global", "",
         ",Type,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker", ",Name,cart,cart,cart,ball,"
         "ball,ball", ",ID,1,1,1,2:1,2:1,2:1",
         ",,Rotation,Rotation,Rotation,Position,Position,Position",
         "Frame,Time (Seconds),X,Y,Z,X,Y,Z"],
        COUNT, T, T, T, T, ACROSS, FALL, SPRING,
    ).encode(), one(ACROSS, FALL, entity="ball")),
    "vicon": Sample("Trial01.csv", table(
        ["Trajectories", "20", ",,rig:ball,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm"],
        COUNT, NONE, 1000 * ACROSS, 1000 * SPRING, 1000 * FALL,
    ).encode(), one(ACROSS, SPRING, entity="ball")),
    "trc": Sample("ball.trc", table(
        ["PathFileType\t4\t(X/Y/Z)\tball.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\t"
         "Units\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
         "20.00\t20.00\t8\t1\tmm\t20.00\t1\t8", "Frame#\tTime\tball\t\t", "\t\tX1\tY1\tZ1", ""],
        COUNT, T, 1000 * ACROSS, 1000 * FALL, 1000 * SPRING, sep="\t",
    ).encode(), one(ACROSS, FALL, entity="ball")),
    "vernier format 2": Sample("cart.txt", table(
        ["Vernier Format 2", "cart.cmbl 11/24/2025 12:51:07", "Run 1", "Time\tPosition", "t\tx",
         "s\tm", ""], T, SPRING, sep="\t",
    ).encode(), one(x=SPRING, scene="Run 1")),
    "a board that writes dates": Sample("20251124-1012.csv", table(
        '"iter","datetime","Hauteur (cm)"', COUNT, [f"24/11/2025 10:12:0{k}" for k in range(8)],
        100 * FALL,
    ).encode(), {(None, OBJECT): (np.arange(8.0), None, FALL)}, up="y"),
    "campbell": Sample("CR1000_Dist.dat", table(
        ['"TOA5","rig","CR1000","1234","CR1000.Std.27","CPU:d.CR1","12345","Dist"',
         '"TIMESTAMP","RECORD","Dist"', '"TS","RN","cm"', '"","","Smp"'],
        [f'"2025-11-24 10:00:0{k / 20:.2f}"' for k in range(8)], COUNT, 100 * SPRING,
    ).encode(), one(x=SPRING)),
    "dltdv": Sample("flightxypts.csv", table(
        "pt1_cam1_X,pt1_cam1_Y,pt2_cam1_X,pt2_cam1_Y", ACROSS, FALL, SPRING, ACROSS,
    ).encode(), one(ACROSS, FALL, entity="pt1_cam1") | one(SPRING, ACROSS, entity="pt2_cam1"),
        options={"fps": 20}, told=("every row is taken as a frame",)),
    "imagej, manual tracking": Sample("Results.txt", table(
        " \tTrack n°\tSlice n°\tX\tY\tDistance\tVelocity\tPixel Value", COUNT, ["1"] * 8, COUNT,
        100 * ACROSS, 100 * SPRING, STILL, STILL, ["120"] * 8, sep="\t",
    ).encode("cp1252"), {(None, "1"): (T + 0.05, 100 * ACROSS, 100 * SPRING)},
        options={"fps": 20}),
    "matlab": Sample("run.csv", table("Var1,Var2,Var3", T, ACROSS, FALL).encode(),
        refused=("--columns", "Var1")),
    "capstone, german": Sample("Feder.csv", table(
        "Zeit (s) Durchgang #1;Position (m) Durchgang #1;Zeit (s) Durchgang #2;"
        "Position (m) Durchgang #2", T, SPRING, T, ACROSS, sep=";", decimal=",",
    ).encode("cp1252"), one(x=SPRING, scene="Durchgang #1") | one(x=ACROSS, scene="Durchgang #2")),
    "cassy": Sample("Pendel.txt", table(
        ["MIN=0\t0", "MAX=5\t2", "SCALE=1\t0,5", "DEC=2\t3", 'DEF="t / s"\t"s_A1 / m"'],
        T, SPRING, sep="\t", decimal=",",
    ).encode("cp1252"), one(x=SPRING), told=("s_A1 / m",)),
    "phyphox, tabs and commas": Sample("Lineal.csv", table(
        '"Zeit (s)"\t"Position (cm)"\t"Geschwindigkeit (cm/s)"', T, 100 * SPRING, 0 * T, sep="\t",
        decimal=",", form="{:.9E}",
    ).encode(), one(x=SPRING)),
    "science journal": Sample("exp.csv", table(
        "relative_time,AccX,AccY,AccZ", [str(50 * k) for k in range(8)], ACROSS, -ACROSS, SPRING,
    ).encode(), twice(ACROSS, -ACROSS), options={"units": {"length": "m", "time": "ms"}},
        told=("sums of accelerations",)),
    "julian dates": Sample("orbit.csv", table(
        "JD,X (au),Y (au)", [f"{2460000.5 + k}" for k in range(8)], ACROSS, FALL,
    ).encode(), {(None, OBJECT): (86400 * (2460000.5 + np.arange(8.0)), AU * ACROSS, AU * FALL)}),
}  # fmt: skip
