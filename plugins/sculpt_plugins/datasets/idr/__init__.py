"""The layout of IDR and NeuS, in which DTU is handed round: cameras.npz, image/, mask/."""
