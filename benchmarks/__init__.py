"""Measurements of mjframes: what a clone runs and a wheel does not have.

tables → solids → contenders → speed → accuracy: a folder imports itself and earlier ones. `stability` imports the
tables alone.

python -m benchmarks.accuracy.report        make report        error against finite elements and MuJoCo's flex
python -m benchmarks.accuracy.factors                          bodies whose stiffness is scaled
python -m benchmarks.accuracy.actuation                        chambers, cables and muscles against finite elements
python -m benchmarks.accuracy.touch                            punches and balls that press, against finite elements
python -m benchmarks.speed.bench            make bench         precomputation and steps
python -m benchmarks.speed.worlds           make bench-worlds  many worlds side by side
python -m benchmarks.speed.dents                               what dents cost in a step
python -m benchmarks.speed.taxels                              what taxels cost in a step
python -m benchmarks.speed.tasks                               random episodes of the tasks of `mjframes.dm`
python -m benchmarks.speed.lift_flex                           lifting a steak, beside flex
python -m benchmarks.stability.check        make check         extreme states
python -m benchmarks.stability.energy       make check         energy that comes from nothing
python -m benchmarks.stability.damage       make check         damaged files
python -m benchmarks.stability.abuse                           random edits of scenes

Each tells its options with --help.
"""
