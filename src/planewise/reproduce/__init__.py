"""The paper's synthetic experiments, run again and put on one page: ``planewise reproduce``.

Every experiment is a module with one `planewise.reproduce.experiment.Experiment`; those that the
command knows are listed in `planewise.reproduce.experiments`. `planewise.reproduce.nyu` is the
paper's evaluation on real frames: ``planewise nyu``.
"""
