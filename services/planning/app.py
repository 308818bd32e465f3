"""The planning service: ``uvicorn services.planning.app:app``."""

from services.planning.processes import PROCESSES
from shared.process.app import create_app

app = create_app("planning", "Smokeglint planning", PROCESSES)
