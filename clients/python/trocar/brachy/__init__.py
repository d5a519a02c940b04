"""Brachytherapy: seed dose calculation, implant plans and their DICOM files, and the motion that carries out a plan.

    >>> from trocar import brachy
    >>> gland = brachy.Structure.from_region(model, "prostate", spacing=1e-3)
    >>> dose = brachy.Dose.at(brachy.Source("I-125 6711"), gland.points)
"""
from ._dose import DVH, Dose, Source, Structure

__all__ = ["DVH", "Dose", "Source", "Structure"]
