"""Images: CT volumes and masks of any header, DICOM folders, and the phantom."""
