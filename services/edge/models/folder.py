"""The folder of models that whoever runs a worker has added: the setting EDGE_MODELS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture2vr.edge.models.card import model_cards
from capture2vr.edge.models.graph import Graph, unavailable
from capture2vr.sentences.sentence import say


@dataclass(frozen=True, slots=True)
class ModelFolder:
    """A folder of models, and the device that runs them."""

    folder: Path
    device: str = "cpu"

    def find(self, name: str) -> Graph | None:
        """Find a model by its name in the table; None where its file is not in the folder. Its hash is checked later.

        Raises ModelError MODEL_UNAVAILABLE where the folder cannot be read.
        """
        card = model_cards()[name]
        try:
            there = {path.name for path in self.folder.iterdir()}
        except OSError as error:
            why = say("models_folder_cannot_be_read", why=error.strerror or error)
            raise unavailable(why, say("name_folder_in_edge_models")) from None
        return Graph(card, self.folder / card.file, self.device) if card.file in there else None
