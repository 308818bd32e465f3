"""The loop left running: daily cycles and hourly ratings on a schedule, without anybody watching."""
