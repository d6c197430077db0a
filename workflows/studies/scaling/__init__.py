"""What a run costs against its size: devices, workers, ARX order, duration of the chirp, records of a campaign."""
