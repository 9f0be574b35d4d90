"""Measurement files without a campaign, for several tests."""

from mcrim_mitsuba.campaign.measurements import measurements_of, read_table, reading_in


def read_measurements(path, scene_parameters=None):
    table = read_table(path, scene_parameters)
    return measurements_of(table, map(reading_in, table.rows))
