"""The access service: ``uvicorn services.access.app:app``."""

from services.access.processes import PROCESSES
from shared.process.app import create_app

app = create_app("access", "Smokeglint access", PROCESSES)
