"""What a device burns and weighs, measured: a bounded experiment, and the device file that it writes."""
