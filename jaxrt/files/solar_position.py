"""Where the sun stands at a date and a place (Blanco-Muriel, Alarcón-Padilla, López-Moratalla and Lara-Coira 2001,
"Computing the solar vector", Solar Energy 70(5)): to half a minute of arc between 1999 and 2015."""

from __future__ import annotations

import datetime

import numpy as np

PARALLAX = 6371.01 / 149597890
"""The earth's radius over its mean distance from the sun."""


def sun_direction(date: datetime.date, hours: float, latitude: float, longitude: float) -> np.ndarray:
    """The unit vector towards the sun: +x south, +y west, +z up, as Mitsuba has them.

    `hours`: universal time since that date's midnight, of any size; latitude and longitude in degrees, north and east
    positive.
    """
    days = date.toordinal() - datetime.date(2000, 1, 1).toordinal() - 0.5 + hours / 24  # since noon of that day
    node, anomaly = 2.1429 - 0.0010394594 * days, 6.2400600 + 0.0172019699 * days
    mean = 4.8950630 + 0.017202791698 * days
    ecliptic = mean + 0.03341607 * np.sin(anomaly) + 0.00034894 * np.sin(2 * anomaly)
    ecliptic += -0.0001134 - 0.0000203 * np.sin(node)
    obliquity = 0.4090928 - 6.2140e-9 * days + 0.0000396 * np.cos(node)
    ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(obliquity) * np.sin(ecliptic))
    sidereal = 6.6974243242 + 0.0657098283 * days + hours  # in Greenwich
    hour = np.radians(15 * sidereal + longitude) - ascension
    phi = np.radians(latitude)
    zenith = np.arccos(np.cos(phi) * np.cos(hour) * np.cos(declination) + np.sin(declination) * np.sin(phi))
    azimuth = np.arctan2(-np.sin(hour), np.tan(declination) * np.cos(phi) - np.sin(phi) * np.cos(hour))
    zenith += PARALLAX * np.sin(zenith)
    return np.array([-np.sin(zenith) * np.cos(azimuth), -np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
