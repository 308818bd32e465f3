"""The prioritization service: ``uvicorn services.prioritization.app:app``."""

from services.prioritization.processes import PROCESSES
from shared.process.app import create_app

app = create_app("prioritization", "Prioritization: fire danger, ratings and targets", PROCESSES)
