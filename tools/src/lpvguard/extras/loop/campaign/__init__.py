"""`lpvguard campaign`: Monte Carlo runs of the simulated truck's closed loop that score the detectors.

    faults.py      the kinds of faults and variations, at several severities
    scenarios.py   the plan: every run's number, truck, fault, speed and command, drawn from the seed
    conduct.py     the loop's conduct in a run, and its contradictions of the certificate
    trucks.py      the trucks within the bounds by their frequency response; mu of loops with faults
    one_run.py     one run: simulated, replayed through the core, judged by every detector and off line
    summary.py     the tables from the rows of the runs, and the claims that the campaign contradicts
    chunked_runs.py  the campaign: it stores finished runs and can be resumed

A campaign has two groups of runs of DURATION_S each. Every run is a scenario of its own, drawn from the
campaign's seed and the number of the run:

    within   trucks that vary in load, CG, tyres, brakes and friction, with a frequency response within the
             bounds at every frequency. Every alarm is false. A run that oscillates, saturates or loses
             track falsifies the certificate. Speeds and demands lie in the checked ranges
    faults   KINDS: one fault or variation, of the truck, of the bus, or of both at once, at several
             severities

There are two separate scores. The detectors of model error are scored on faults of the truck, with or without
a fault of the bus. The supervision is scored on faults of the bus, with or without a fault of the truck. The
frames on the bus and the message table determine the required state of the supervision at every tick
(supervision.py). If only the bus has a fault, alarms of the detectors are counted but not scored. A detector
sees only values, so an accepted wrong or late value is a model error for it.

Files in the campaign's folder (each whole or absent):

    MANIFEST.json      seed, sizes, inputs, and the seal of the files so far; another campaign is refused
    baselines.json     parameters and thresholds of the baselines (evaluate.BaselineStudy, all calibration
                       drives)
    plants.json        |delta|/W_delta of the candidates for "within" and of the trucks with faults
    loops.json         mu of the loops with faults, if a controller was given
    chunks/NNNNN.parquet   rows of CHUNK runs
    runs.parquet       all rows
    summary.json       the tables
"""
