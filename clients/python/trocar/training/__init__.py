"""Training: tasks and courses for trainees, and scoring of recorded runs.

    >>> from trocar.training import Task, score
    >>> result = score(Task.read("meshes/tasks/one-needle.yaml"), "session.log")
    >>> result.passed, result.measures["tip_error"]

The command-line program is `trocar-score`. trocar-view runs it at the end of a task, so both report the same numbers.
"""
from ._recording import BadRecording
from ._score import MEASURES, Judgement, Result, score
from ._task import BadTask, Course, Criterion, Target, Task

__all__ = ["MEASURES", "BadRecording", "BadTask", "Course", "Criterion", "Judgement", "Result", "Target", "Task", "score"]
