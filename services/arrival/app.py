"""The arrival service: `uvicorn services.arrival.app:app`."""

from services.arrival.processes import PROCESSES
from shared.process.app import create_app

app = create_app("arrival", "Smokeglint arrival: when the fire reached every place", PROCESSES)
