# SPDX-License-Identifier: Apache-2.0
"""Learning to feel: splits, baselines, training of networks and contact models, calibration, judging.

    collection ─ division ─┬─ training_set ─ train, srgan (both a trainer, in a place, by a stepper) ─┬─ run ─ run_folder, run_card
                           └─ contact_training ─ contact_predictor ─ calibration ─ contact_run ───────┘
    splits ─ evaluation: a kind of model, trained anew on each fold     judging: a trained model, as it is

Nothing is re-exported: `splits`, `metrics` and `baselines` stay free of torch, which `train` imports.
"""
