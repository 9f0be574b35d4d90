"""Measurement files without a campaign, for several tests."""

from types import MappingProxyType

from mcrim_mitsuba.campaign.measurements import read_table


def read_measurements(path, scene_parameters=MappingProxyType({})):
    table = read_table(path, scene_parameters)
    return table.with_readings(table.readings)
