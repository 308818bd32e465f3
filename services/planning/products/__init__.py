"""What leaves the planner: command files, tables, charts, maps and the report."""
