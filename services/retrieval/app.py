"""The retrieval service: ``uvicorn services.retrieval.app:app``."""

from services.retrieval.processes import PROCESSES
from shared.process.app import create_app

app = create_app("retrieval", "Smokeglint retrieval", PROCESSES)
