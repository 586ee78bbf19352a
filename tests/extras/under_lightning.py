"""A program of two ranks: the samples of a Lightning model and of Fabric; Lightning keeps our sampler."""

import sys
from typing import Any

import lightning
import torch
from torch.utils.data import DataLoader

from gcd_dataset.loaders import ElasticSampler, GarmentDataset, GarmentLoader

garments = GarmentDataset(sys.argv[1], fields=["meta"])


def numbers(items: list[Any]) -> torch.Tensor:
    return torch.tensor([item["meta"]["index"] for item in items])


class Model(lightning.LightningModule):  # type: ignore[misc]  # lightning is untyped
    def __init__(self) -> None:
        super().__init__()
        self.net = torch.nn.Linear(1, 1)

    def train_dataloader(self) -> DataLoader:
        """Called once the process group exists."""
        return DataLoader(garments, 4, sampler=ElasticSampler(garments), num_workers=1, collate_fn=numbers)

    def training_step(self, batch: torch.Tensor, number: int) -> torch.Tensor:
        print("train", self.current_epoch, batch.tolist(), flush=True)
        return self.net(batch[:, None].float()).mean()

    def validation_step(self, batch: torch.Tensor, number: int) -> None:
        if not self.trainer.sanity_checking:
            print("validate", self.current_epoch, batch.tolist(), flush=True)

    def configure_optimizers(self) -> Any:
        return torch.optim.SGD(self.parameters(), 1e-9)


quiet: dict[str, Any] = {"logger": False, "enable_progress_bar": False, "enable_checkpointing": False}
trainer = lightning.Trainer(accelerator="cpu", devices=2, strategy="ddp", max_epochs=2, **quiet)
validation = GarmentLoader(garments, 4, shuffle=False, collate_fn=numbers)
trainer.fit(Model(), val_dataloaders=validation)

fabric = lightning.Fabric(accelerator="cpu", devices=2, strategy="ddp")
fabric.launch()
loader = fabric.setup_dataloaders(DataLoader(garments, 4, sampler=ElasticSampler(garments), collate_fn=numbers))
for epoch in range(2):
    for batch in loader:
        print("fabric", epoch, batch.tolist(), flush=True)
