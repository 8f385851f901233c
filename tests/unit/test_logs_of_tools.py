"""Logs as public programs write them, drawn anew: one drive of known metres and energy, in the shape of each."""

import io
import json
from datetime import datetime, timedelta
from functools import reduce
from operator import xor

import numpy as np
import pytest
from scipy.io import netcdf_file, savemat

from joulemap.model.errors import RunsError
from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.logs import read_log
from joulemap.model.runs.plausible import of_length, of_meter
from joulemap.model.runs.reader import parse_run

T = np.arange(0.0, 600.0)
V = 10.0 * (0.6 + 0.4 * np.sin(T / 15.0)) * np.clip(T / 8, 0, 1) * np.clip((599 - T) / 8, 0, 1)  # a car at 1 Hz [m/s]
S = np.concatenate([[0.0], np.cumsum(0.5 * (V[1:] + V[:-1]))])
WAY = np.radians(40.0 + 60.0 * np.sin(S / 900.0))
X, Y = (np.concatenate([[0.0], np.cumsum(f(WAY[1:]) * np.diff(S))]) for f in (np.sin, np.cos))
LAT, LON = 48.2 + Y / 111_200.0, 11.5 + X / (111_320.0 * np.cos(np.radians(48.2)))
ZIGZAG = 0.004 * np.abs((T / 60.0) % 2.0 - 1.0)  # [deg]
W = 600.0 + 1500.0 * np.gradient(V) * V + 250.0 * V  # what it draws, and feeds back in braking [W]
U = 360.0 - 0.001 * T
AMPS = W / U
JOULES = float(np.sum(0.5 * (W[1:] + W[:-1])))
ROWS = range(T.size)
BEGIN = datetime(2024, 6, 3, 14, 20, 5)
COLUMNS = {"t": T, "lat": LAT, "lon": LON, "u": U, "i": AMPS}


def at(k: int, form: str) -> str:
    return (BEGIN + timedelta(seconds=float(T[k]))).strftime(form)


def iso(k: int) -> str:
    return at(k, "%Y-%m-%dT%H:%M:%SZ")


def row(k: int, *, separator: str = ",", digits: int = 7) -> str:
    return separator.join(f"{values[k]:.{digits}f}" for values in COLUMNS.values())


def table(head: str, line=row, before: str = "") -> str:
    return f"{before}{head}\n" + "".join(f"{line(k)}\n" for k in ROWS)


def by_name(head: str, line, names=("lat", "lon", "u", "i"), before: str = "") -> str:
    values = {"lat": LAT, "lon": LON, "u": U, "i": AMPS}
    return f"{before}{head}\n" + "".join(f"{line(k, n, values[n][k])}\n" for n in names for k in ROWS)


def sentence(content: str) -> str:
    return f"${content}*{reduce(xor, content.encode()):02X}\r\n"


def arc(degrees: float, width: int) -> str:
    return f"{int(degrees):0{width}d}{60 * (degrees % 1):010.7f}"


def of_nmea(k: int, battery: str) -> str:
    place, time = f"{arc(LAT[k], 2)},N,{arc(LON[k], 3)},E", at(k, "%H%M%S.25")
    return "".join(
        map(
            sentence,
            (
                f"GNRMC,{time},A,{place},{V[k] / 0.514444:.3f},40.0,{at(k, '%d%m%y')},,,R",
                f"GNGGA,{time},{place},4,17,0.7,420.0,M,47.2,M,1.0,0000",
                battery.format(time=time, u=U[k], i=AMPS[k]),
            ),
        )
    )


UNIT = {"u": "V", "i": "A"}
FULL = {"lat": "latitude", "lon": "longitude", "u": "battery_voltage", "i": "battery_current"}
SHAPES = {
    "Campbell: four lines of header, means of each interval": table(
        '"TIMESTAMP","RECORD","Lat","Lon","BattV_Avg","BattI_Avg","Speed_Max"\n"TS","RN","deg","deg","Volts","Amps","m/s"\n'
        '"","","Smp","Smp","Avg","Avg","Max"',
        lambda k: f'"{iso(k)}",{k},{row(k).split(",", 1)[1]},99',
        before='"TOA5","CR1000X","CR1000X","1","CR1000X.Std.05","CPU:rover.CR1X","1","Drive"\n',
    ),
    "MoTeC: a block of remarks, blank lines, names, units": table(
        '"Time","GPS Latitude","GPS Longitude","HV Pack Voltage","HV Pack Current"\n"s","deg","deg","V","A"\n',
        before='"Format","MoTeC CSV File",,,"Workbook"\n"Sample Rate","1.000",,"End Time","600","s"\n\n\n',
    ),
    "MoTeC: a row of units that says another one than the name": table(
        "Time,GPS Latitude,GPS Longitude,Batt Volts,Batt Curr\ns,deg,deg,mV,mA",
        lambda k: f"{T[k]},{LAT[k]:.7f},{LON[k]:.7f},{1000 * U[k]:.0f},{1000 * AMPS[k]:.1f}",
    ),
    "LabVIEW: two headers, decimal commas, and the time as X_Value": table(
        "X_Value\tVoltage_0\tCurrent_1\tPos_X\tPos_Y\tComment",
        lambda k: "\t".join(f"{v:.6f}" for v in (T[k], U[k], AMPS[k], X[k], Y[k])).replace(".", ",") + "\t",
        before="LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n***End_of_Header***\t\n"
        "\t\nChannels\t4\t\t\t\nY_Unit_Label\tVolts\tAmperes\tMeters\tMeters\nX_Dimension\tTime\tTime\tTime\tTime\n"
        "Delta_X\t1,000000\t1,000000\t1,000000\t1,000000\n***End_of_Header***\t\t\t\t\n",
    ),
    "lines that begin with a bracket": table(
        "", lambda k: f"[{T[k]:.1f}] t={T[k]:.1f} lat={LAT[k]:.7f} lon={LON[k]:.7f} voltage={U[k]} current={AMPS[k]}"
    ).lstrip(),
    "the console of ROS": table(
        "",
        lambda k: f"[INFO] [{1767225600 + T[k]:.1f}] [robot]: lat={LAT[k]:.7f} lon={LON[k]:.7f} voltage={U[k]} "
        f"current={AMPS[k]}",
    ).lstrip(),
    "RaceChrono: names, units and sources": table(
        "timestamp,latitude,longitude,battery_voltage,battery_current\nunix time,deg,deg,V,A\n,100: gps,,canbus,canbus",
        before="This file is created using RaceChrono Pro\nFormat,3\nCreated,03/06/2024,14:20\nNote,\n\n",
    ),
    "Racelogic VBO: minutes, positive to the west, hhmmss": table(
        "[column names]\ntime lat long Pack_Voltage Pack_Current\n\n[data]",
        lambda k: f"{at(k, '%H%M%S')}.00 +{60 * LAT[k]:.6f} -{60 * LON[k]:.6f} {U[k]:+.6E} {AMPS[k]:+.6E}",
        before="File created on 03/06/2024 at 14:20:05\n\n[header]\ntime\nlatitude\nlongitude\n\n",
    ),
    "LabVIEW: marks between headers": table(
        "Time [s]\tLatitude\tLongitude\tVoltage [V]\tCurrent [A]",
        lambda k: row(k, separator="\t"),
        before="Date\t2024/06/03\n***End_of_Header***\n\nSamples\t600\t600\t600\t600\n***End_of_Header***\n",
    ),
    "LabVIEW: lines of numbers before the header, and a lone X": table(
        "X_Value\tWheel Speed\tVoltage\tCurrent\tComment",
        lambda k: f"{T[k]:.6f}\t{3.6 * V[k]:.6f}\t{U[k]:.6f}\t{AMPS[k]:.6f}",
        before="LabVIEW Measurement\n***End_of_Header***\n\nChannels\t3\nSamples\t600\t600\t600\n"
        "Y_Unit_Label\tkm/h\tV\tA\n"
        "X0\t0.0\t0.0\t0.0\nDelta_X\t1.0\t1.0\t1.0\n***End_of_Header***\n",
    ),
    "two lines of comments as header": table(
        "%  time  lat  lon  volt  amp\n%  [s]  [deg]  [deg]  [V]  [A]", lambda k: row(k, separator="   ")
    ),
    "tabs and decimal commas": table(
        "Zeit [s]\tLatitude\tLongitude\tSpannung [V]\tStrom [A]", lambda k: row(k, separator="\t").replace(".", ",")
    ),
    "names in German, without units": table(
        "Zeit;Breitengrad;Längengrad;Batteriespannung;Gesamtstrom;Soll-Strom",
        lambda k: row(k, separator=";") + ";7",
    ),
    "names in Spanish, without units": table("tiempo,latitud,longitud,voltaje,corriente"),
    "names in Italian and Dutch": table(
        "tempo;latitudine;lengtegraad;tensione;stroom", lambda k: row(k, separator=";")
    ),
    "letters of quantities before the part": table(
        "time,lat,lon,Ubat_ev,I_bat_ev,kmph_meas", lambda k: f"{row(k)},{3.6 * V[k]}"
    ),
    "Car Scanner: rows by PID": by_name(
        '"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";"LONGTITUDE";',
        lambda k, n, v: f'"{51_605 + T[k]:.2f}";"[BMS] HV {FULL[n]}";"{v:.7f}";"{UNIT[n]}";"{LAT[k]:.7f}";'
        + f'"{LON[k]:.7f}";',
        names=("u", "i"),
    ),
    "InfluxDB: annotated": by_name(
        ",result,table,_start,_time,_value,_field,_measurement",
        lambda k, n, v: f",,0,2024-06-03T14:00:00Z,{iso(k)},{v:.7f},{FULL[n]},rover",
        before="#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,double,string,string\n",
    ),
    "Home Assistant: history": by_name(
        "entity_id,state,last_changed", lambda k, n, v: f"sensor.car_{FULL[n]},{v:.7f},{iso(k)}"
    ),
    "lines of name=value": "".join(
        f"t={T[k]:.2f} lat={LAT[k]:.7f} lon={LON[k]:.7f} vbat={U[k]:.3f} ibat={AMPS[k]:.4f}\n" for k in ROWS
    ),
    "InfluxDB's line protocol": "".join(
        f"rover,id=r1 lat={LAT[k]:.7f},lon={LON[k]:.7f},voltage={U[k]:.3f},current={AMPS[k]:.4f} {1717424405 + k}"
        "000000000\n"
        for k in ROWS
    ),
    "InfluxDB's export, with its preamble and another voltage": "# DDL\nCREATE DATABASE robots WITH NAME autogen\n"
    "# DML\n# CONTEXT-DATABASE:robots\n# CONTEXT-RETENTION-POLICY:autogen\n"
    + "".join(
        f"battery,host=r1 voltage={U[k]:.3f},current={AMPS[k]:.4f},charging=false {1717424405 + k}000000000\n"
        f'radio,host=r1 voltage=5.0,mode="a b" {1717424405 + k}000000000\n'
        f"pose,mode={'auto' if k % 200 < 100 else 'manual'},host=r1 lat={LAT[k]:.7f},lon={LON[k]:.7f},seq={k}i "
        f"{1717424405 + k}000000000\n"
        for k in ROWS
    ),
    "NMEA: a proprietary sentence of the battery": "".join(
        of_nmea(k, "PBAT,{time},{u:.3f},V,{i:.4f},A,88") + "$GNRMC,broken*00\r\n" * (k == 9) for k in ROWS
    ),
    "NMEA: the battery as transducers": "".join(of_nmea(k, "IIXDR,U,{u:.3f},V,BATT,I,{i:.4f},A,BATT") for k in ROWS),
    "Mission Planner: messages in CSV": "".join(
        f"{iso(k)[:-1]}.250,FD,1C,0,0,{k % 256},1,1,21,mavlink_global_position_int_t,time_boot_ms,{83200 + 1000 * k},"
        f"lat,{1e7 * LAT[k]:.0f},lon,{1e7 * LON[k]:.0f},alt,420189,relative_alt,189,vx,21,vy,-12,vz,0,hdg,330,,Len,40\n"
        f"{iso(k)[:-1]}.260,FD,1F,0,0,{k % 256},1,1,1,mavlink_sys_status_t,onboard_control_sensors_present,325188655,"
        f"load,212,voltage_battery,{100 * U[k]:.0f},current_battery,{1000 * AMPS[k]:.0f},battery_remaining,88,,Len,43\n"
        for k in ROWS
    ),
    "OpenMetrics: a series after another": "".join(
        f"# HELP robot_{name} of it\n# TYPE robot_{name} gauge\n"
        + "".join(f'robot_{name}{{instance="r1:9100"}} {values[k]:.7f} {1717424405 + k}.250\n' for k in ROWS)
        for name, values in {
            "battery_voltage_volts": U,
            "battery_current_amperes": AMPS,
            "gps_latitude_degrees": LAT,
            "gps_longitude_degrees": LON,
        }.items()
    )
    + "# EOF\n",
    "Grafana: watts and kilowatts in one column": table(
        '"Time","Latitude","Longitude","Power"',
        lambda k: f'"{at(k, "%Y-%m-%d %H:%M:%S")}",{LAT[k]:.7f},{LON[k]:.7f},'
        + (f'"{W[k] / 1000:.4f} kW"' if abs(W[k]) >= 1000 else f'"{W[k]:.1f} W"'),
    ),
    "EdgeTX: one cell with both degrees": table(
        "Date,Time,GPS,RxBt(V),Curr(A),TxBat(V)",
        lambda k: f"{at(k, '%Y-%m-%d,%H:%M:%S')}.00,{LAT[k]:.7f} {LON[k]:.7f},{U[k]:.2f},{AMPS[k]:.3f},7.9",
    ),
    "Torque: two voltages, one of the battery": table(
        "Device Time, Longitude, Latitude,HV Battery Voltage(V),HV Battery Current(A),Voltage (Control Module)(V)",
        lambda k: f"{at(k, '%d-%b-%Y %H:%M:%S')}.0,{LON[k]},{LAT[k]},{U[k]},{AMPS[k]},{13.9 + 0.01 * (k % 7)}",
    ),
    "FIT as CSV: semicircles": table(
        "timestamp,position_lat,position_long,power",
        lambda k: f"{iso(k)},{LAT[k] * 2**31 / 180:.0f},{LON[k] * 2**31 / 180:.0f},{W[k]:.1f}",
    ),
    "a receiver without a fix": table(
        "ms;input_voltage;current_in;speed_meters_per_sec;gnss_lat;gnss_lon;",
        lambda k: f"{1000 * k};{U[k]:.3f};{AMPS[k]:.4f};{V[k]:.3f};0.00000000;0.00000000;",
    ),
    "rostopic: seconds and nanoseconds": table(
        "header.stamp.secs,header.stamp.nsecs,field.latitude,field.longitude,voltage,current",
        lambda k: f"{1717424405 + k},0,{LAT[k]:.7f},{LON[k]:.7f},{U[k]:.3f},{AMPS[k]:.4f}",
    ),
    "degrees called x and y": table(
        "time,position_x,position_y,battery_voltage,battery_current",
        lambda k: f"{T[k]},{LON[k]},{LAT[k]},{U[k]:.3f},{AMPS[k]:.4f}",
    ),
    "rosbridge: two topics in JSON lines": "".join(
        json.dumps({"topic": topic, "msg": {"header": {"stamp": {"sec": 1717424405 + k, "nanosec": 0}}} | more}) + "\n"
        for k in ROWS
        for topic, more in (
            ("/battery", {"voltage": U[k], "current": -AMPS[k]}),
            ("/odom", {"pose": {"pose": {"position": {"x": X[k], "y": Y[k]}}}}),
        )
    ),
    "units beside values, in JSON lines": "".join(
        json.dumps({"ts": iso(k), "lat": LAT[k], "lon": LON[k], "battery": {
            "voltage": {"value": 1e3 * U[k], "unit": "mV"}, "current": {"value": 1e3 * AMPS[k], "unit": "mA"}}})
        + "\n"
        for k in ROWS
    ),
    "voltage and current of one part": table(
        "time,latitude,longitude,PackVolt,PackAmps,BatteryVolt", lambda k: f"{row(k)},{13.9 + 0.01 * (k % 7)}"
    ),
    "milliseconds, millivolts and milliamperes that no name says": table(
        "Time,Battery voltage,Battery current,Speed (km/h)",
        lambda k: f"{1000 * k},{1e3 * U[k]:.0f},{1e3 * AMPS[k]:.0f},{3.6 * V[k]:.1f}",
    ),
    "Prometheus: a series for each metric": json.dumps(
        {"status": "success", "data": {"result": [
            {"metric": {"__name__": name, "job": "rover"}, "values": [[1717424405 + k, f"{v[k]:.7f}"] for k in ROWS]}
            for name, v in {"latitude": LAT, "longitude": LON, "battery_power_watts": W}.items()
        ]}}
    ),
    "parts of a table in no order of time": "t,lat,lon,voltage,current\n"
    + "".join(f"{row(int(k))}\n" for k in np.random.default_rng(1).permutation(T.size)),
    "kilowatts that the way alone tells": table(
        "time,latitude,longitude,power", lambda k: f"{T[k]},{LAT[k]:.7f},{LON[k]:.7f},{W[k] / 1000:.5f}"
    ),
    "Strava's streams: columns with remarks": json.dumps(
        {
            "time": {"data": T.tolist(), "series_type": "time"},
            "latlng": {"data": [[a, b] for a, b in zip(LAT.tolist(), LON.tolist(), strict=True)]},
            "watts": {"data": W.tolist()},
        }
    ),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
def test_a_log_is_read_as_its_program_means_it(shape):
    run = parse_run(SHAPES[shape], name="r", crs="EPSG:32632")
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.02)
    assert cut_segments(run).driven_m.sum() == pytest.approx(S[-1], rel=0.02)


def test_series_of_two_batteries_are_not_mixed():
    lines = [
        f"battery,pack={pack} voltage={U[k]:.3f},current={share * AMPS[k]:.4f} {1717424405 + k}000000000\n"
        f"pose lat={LAT[k]:.7f},lon={LON[k]:.7f} {1717424405 + k}000000000\n"
        for k in ROWS
        for pack, share in (("1", 0.6), ("2", 0.4))
    ]
    run = parse_run("".join(lines), name="r", crs="EPSG:32632")
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.02)
    assert "1.voltage" in run.reading["power"]


@pytest.mark.parametrize("kind", ["mat", "npz", "nc"])
def test_arrays_of_numerical_programs_are_columns(kind):
    out, arrays = io.BytesIO(), {"time": T, "x": X, "y": Y, "battery_voltage": U, "battery_current": AMPS}
    if kind == "mat":
        savemat(out, {"run": arrays, "mass_kg": 1500.0})
    elif kind == "nc":
        file = netcdf_file(out, "w")
        file.createDimension("time", T.size)
        for key, values in arrays.items():
            file.createVariable(key, "f8", ("time",))[:] = values
        file.variables["battery_current"].units = "A"
        file.flush()
    else:
        arrays["time"] = np.datetime64("2024-05-14T09:12:03") + (1e3 * T).astype("timedelta64[ms]")
        np.savez(out, **arrays, names=np.array(["a", "b"]), meta=np.array([{"robot": "r"}, None]))
    run = parse_run(out.getvalue(), name=f"r.{kind}")
    assert run.energy()[0] == pytest.approx(JOULES, rel=0.01)
    assert cut_segments(run).driven_m.sum() == pytest.approx(S[-1], rel=0.01)


@pytest.mark.parametrize(
    ("head", "last", "match"),
    [
        ("t,speed [m/s],distance [m],voltage,current", lambda k: 3.6 * V[k], r"its distance is 0.278 times the sum of"),
        (
            "t,speed [m/s],power [kW],voltage,current",
            lambda k: V[k],
            r"power \[kW\] is 1000 times voltage times current",
        ),
    ],
)
def test_units_that_contradict_each_other_are_refused(head, last, match):
    other = W if "power" in head else S
    with pytest.raises(RunsError, match=match):
        parse_run(table(head, lambda k: f"{T[k]},{last(k)},{other[k]},{U[k]},{AMPS[k]}"), name="r")


def test_positions_that_are_too_rare_for_the_way_are_said():
    text = table("t,lat,lon,voltage,current,speed", lambda k: f"{row(k)},{V[k]}").splitlines()
    run = parse_run("\n".join([text[0], *text[1::60]]) + "\n", name="r", crs="EPSG:32632")
    (said,) = of_length(run, cut_segments(run))
    assert "positions are too rare to show its curves" in said
    dense = parse_run("\n".join(text) + "\n", name="r", crs="EPSG:32632")
    assert of_length(dense, cut_segments(dense)) == []


def test_rows_of_five_seconds_make_no_slow_driving_a_stop():
    """What a vehicle accelerates between such rows was taken for noise, and 4 m/s for standing: a tenth of the way."""
    text = table("t,lat,lon,voltage,current").splitlines()
    run = parse_run("\n".join([text[0], *text[1::5]]) + "\n", name="r", crs="EPSG:32632")
    assert cut_segments(run).driven_m.sum() == pytest.approx(S[-1], rel=0.02)


def test_corners_between_rare_fixes_are_not_cut():
    """A fix in 20 s was smoothed over 20 s: 4 % of a winding way were lost."""
    text = table("t,lat,lon,voltage,current", lambda k: row(k).replace(f"{LAT[k]:.7f}", f"{48.2 + ZIGZAG[k]:.7f}"))
    run = parse_run("\n".join([text.splitlines()[0], *text.splitlines()[1::20]]) + "\n", name="r", crs="EPSG:32632")
    x, y = run.x[np.isfinite(run.x)], run.y[np.isfinite(run.y)]
    assert cut_segments(run).track_m == pytest.approx(np.hypot(np.diff(x), np.diff(y)).sum(), rel=0.002)


@pytest.mark.parametrize("seconds", [1, 2, 4])
@pytest.mark.parametrize("noise_m", [0.0, 0.05])
def test_a_way_through_curves_is_as_long_as_its_fixes_say(seconds, noise_m):
    """A fix in 4 s was smoothed over 4 s: 3 % of a drive through a town were lost. A slow robot's noise is smoothed."""
    t = np.arange(0.0, 1800.0, seconds)
    rng = np.random.default_rng(seconds)
    for radius, speed in ((30.0, 6.0), (2.0, 0.3)):
        turned = speed * t / radius
        x, y = (radius * f(turned) + noise_m * rng.standard_normal(t.size) for f in (np.sin, np.cos))
        text = "t,x,y,current [A]\n" + "".join(f"{a},{b},{c},2\n" for a, b, c in zip(t, x, y, strict=True))
        way = 2.0 * radius * np.sin(speed * seconds / radius / 2.0) * (t.size - 1)
        track = cut_segments(parse_run(text, name="r"), length_m=max(1.0, 1.1 * speed * seconds / 2.4), charge=True)
        assert track.track_m == pytest.approx(way, rel=0.01 if noise_m == 0.0 or speed > 1.0 else 0.2)


def test_a_jump_is_no_curve():
    """Nor is the noise of a slow robot's fixes, a third of its steps: both were once taken for curves."""
    t, rng = np.arange(0.0, 900.0), np.random.default_rng(5)
    x, y = 0.3 * t + 500.0 * (t >= 300) - 400.0 * (t >= 600), 700.0 * (t >= 300) * (t < 600)
    x, y = (each + 0.1 * rng.standard_normal(t.size) for each in (x, y))
    text = "t,x,y,current [A]\n" + "".join(f"{a},{b},{c},2\n" for a, b, c in zip(t, x, y, strict=True))
    track = cut_segments(parse_run(text, name="r"), charge=True)
    assert track.driven_m.sum() == pytest.approx(0.3 * 900.0, rel=0.05)


def test_a_counter_has_its_sum_whatever_the_stamps_are_rounded_to():
    t = np.round(0.25 + 0.5 * np.arange(1200), 1)
    counted = np.cumsum(0.02 + 0.01 * np.sin(np.arange(1200) / 9.0))
    text = "t,x,y,energy_wh\n" + "".join(f"{a:.1f},{0.4 * a:.3f},0,{b:.5f}\n" for a, b in zip(t, counted, strict=True))
    assert parse_run(text, name="r").energy()[0] == pytest.approx(3600.0 * (counted[-1] - counted[0]), rel=1e-3)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"lat": LON + 90.0, "lon": -LAT, "voltage": U, "current": AMPS}, "lat is about 101.5"),
        ({"lat": LAT, "lon": LON, "wifi_signal_power_dbm": -60.0 + T % 7}, "there is neither a column 'current'"),
    ],
)
def test_numbers_that_are_no_latitude_and_no_power_are_refused(columns, words):
    text = f"t,{','.join(columns)}\n" + "".join(
        f"{T[k]},{','.join(str(v[k]) for v in columns.values())}\n" for k in ROWS
    )
    with pytest.raises(RunsError, match=words):
        parse_run(text, name="r", crs="EPSG:32632")


def test_forces_are_no_latitudes_and_a_share_of_one_is_in_per_cent():
    head = "Time [s],Distance [m],G Force Lat [G],G Force Long [G],voltage,current,battery.percentage"
    text = table(head, lambda k: f"{T[k]},{S[k]},0.{k % 9},-0.{k % 7},{U[k]},{AMPS[k]},{0.9 - 1e-4 * k:.4f}")
    assert np.nanmax(parse_run(text, name="r").y) == pytest.approx(S[-1], rel=0.001)
    assert read_log(text, "r", {}).numbers["soc"][0] == pytest.approx(90.0)


def test_a_meter_that_stops_and_one_that_reads_nearly_nothing_are_said():
    stopped = np.where(T < 200, AMPS, AMPS[200])
    for amps, words in ((stopped, "had its meter stopped"), (AMPS * 1e-5, "less than a model car takes"), (AMPS, "")):
        rows = (f"{T[k]},{LAT[k]:.7f},{LON[k]:.7f},360,{amps[k]}\n" for k in ROWS)
        run = parse_run("t,lat,lon,voltage,current\n" + "".join(rows), name="r", crs="EPSG:32632")
        said = of_meter(run, cut_segments(run))
        assert [words in each for each in said] == ([True] if words else [])


def test_a_log_of_changes_has_each_value_until_the_next():
    """As Home Assistant writes it: between two changes nothing is missing, and at rest nothing rises slowly."""
    stairs = {"speed": np.round(2.0 * V * (T % 120 > 60)) / 2.0, "power": np.round(W * (T % 120 > 60), -2) + 40.0}
    changed = {
        key: [k for k in ROWS if k in (0, T.size - 1) or values[k] != values[k - 1]] for key, values in stairs.items()
    }
    text = "entity_id,state,last_changed\n" + "".join(
        f"sensor.rover_{key},unavailable,{iso(0)[:-3]}00Z\n"
        + "".join(f"sensor.rover_{key},{stairs[key][k]},{iso(k)}\n" for k in rows)
        for key, rows in changed.items()
    )
    run = parse_run(text, name="r", mapping={"speed": "sensor.rover_speed:m/s"})
    assert np.nanmax(run.y) == pytest.approx(stairs["speed"].sum(), rel=0.005)
    assert run.energy()[0] == pytest.approx(stairs["power"][:-1].sum(), rel=0.005)


def test_time_in_which_the_speed_is_not_known_is_said():
    text = table("t,speed [m/s],power [W]", lambda k: f"{T[k]},{V[k]},{W[k]}").splitlines()
    run = parse_run("\n".join([*text[:200], *text[300:]]) + "\n", name="r")
    assert "its speed is not known for 101 s in all: what was driven then is not counted" in run.notes


def test_a_distance_since_the_last_row_is_no_counter():
    step = np.round(np.diff(S, prepend=0.0) * (T % 60 > 20), 1)
    bare = table("t,distance,power [W]", lambda k: f"{T[k]},{step[k]},{W[k]}")
    with pytest.raises(RunsError, match=r"rises and falls again and again.* distance=distance:m/row"):
        parse_run(bare, name="r")
    told = parse_run(bare, name="r", mapping={"distance": "distance:m/row"})
    assert np.nanmax(told.y) == pytest.approx(step.sum() - step[0], rel=1e-3)
    with pytest.raises(RunsError, match="`power` cannot be in 'W/row'"):
        parse_run(bare, name="r", mapping={"power": "power [W]:W/row"})
    run = parse_run(table("t,distance,speed [m/s],power [W]", lambda k: f"{T[k]},{step[k]},{V[k]},{W[k]}"), name="r")
    assert np.nanmax(run.y) == pytest.approx(S[-1], rel=0.01)
    half = table("t,distance,speed [m/s],power [W]", lambda k: f"{T[k]},{0.55 * S[k]},{V[k]},{W[k]}")
    assert any("where its speed makes" in note for note in parse_run(half, name="r").notes)


def test_the_voltage_of_a_supply_is_no_power():
    """As trackers send it: in W too little for the air at that speed, and in kW as much at rest as while driving."""
    stopped = np.where((T > 200) & (T < 260), 0.0, 2.0 * V)
    head = "t,speed [m/s],power"
    with pytest.raises(RunsError, match="nothing in it carries power"):
        parse_run(table(head, lambda k: f"{T[k]},{stopped[k]},14.1"), name="r")
    run = parse_run(table(head, lambda k: f"{T[k]},{stopped[k]},{0.4 + 1.3 * stopped[k]:.0f}"), name="r")
    assert run.reading["power"] == "power [kW]"


def test_braking_for_seconds_is_no_spike_and_one_row_is():
    braked = np.where((T >= 300) & (T < 303), -60_000.0, W)
    run = parse_run(
        table("t,lat,lon,power", lambda k: f"{T[k]},{LAT[k]},{LON[k]},{braked[k]}"), name="r", crs="EPSG:32632"
    )
    np.testing.assert_allclose(run.power_w, braked)
    wrong = np.where(T == 300, 900_000.0, W)
    run = parse_run(
        table("t,lat,lon,power", lambda k: f"{T[k]},{LAT[k]},{LON[k]},{wrong[k]}"), name="r", crs="EPSG:32632"
    )
    assert run.power_w[300] < 60_000.0


def test_currents_of_a_part_are_not_that_of_the_battery():
    """A Husky's status: without its sum, half of the energy would be read."""
    with pytest.raises(RunsError, match="neither a column 'current'"):
        parse_run(
            table("t,lat,lon,battery_voltage,mcu_and_user_port_current,left_driver_current,right_driver_current",
                  lambda k: row(k) + f",{AMPS[k]:.3f},{AMPS[k]:.3f}"),
            name="r", crs="EPSG:32632",
        )  # fmt: skip
