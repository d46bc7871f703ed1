"""Emitters: what is sampled towards light. The enclosure is met by reflected rays and needs no sampling of its own."""

from .area import LightSample, density, may_meet, sample

__all__ = ["LightSample", "density", "may_meet", "sample"]
