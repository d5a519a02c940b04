"""Training: tasks and courses for a trainee at the simulator, and the score of a recorded run.

    >>> from trocar.training import Task, score
    >>> result = score(Task.read("meshes/tasks/one-needle.yaml"), "session.log")
    >>> result.passed, result.measures["tip_error"]

`trocar-score` is the program; trocar-view runs it at the end of a task, so that the numbers are the same.
"""
from ._recording import BadRecording
from ._score import MEASURES, Judgement, Result, score
from ._task import BadTask, Course, Criterion, Target, Task

__all__ = ["MEASURES", "BadRecording", "BadTask", "Course", "Criterion", "Judgement", "Result", "Target", "Task", "score"]
