"""Measure the friction that is left at rising amplitudes, as a procedure of PyMeasure.

Results go into a CSV file that PyMeasure's windows show live. The stimulator is simulated: with
hardware, connect instead. Tried by hand with PyMeasure 0.16.
"""

from pymeasure.experiment import FloatParameter, Procedure, Results, Worker

from smarttac_can.bench import Stimulator


class Friction(Procedure):
    """COF at five amplitudes."""

    most = FloatParameter("Largest amplitude", units="um", default=2.0)
    DATA_COLUMNS = ("Amplitude (um)", "COF")

    def startup(self) -> None:
        """Put a finger on the plate."""
        self.bench = Stimulator.simulate("local")
        self.bench.finger.stroke(2)
        self.bench.start_run()
        self.bench.tare()

    def execute(self) -> None:
        """Regulate one amplitude after the other."""
        for step in range(1, 6):
            self.bench.amplitude = self.most * step / 5
            self.bench.mode = "amplitude_resonance"
            trace = self.bench.run(0.8)
            self.emit("results", {"Amplitude (um)": trace.amplitude_um[-1], "COF": trace.cof[-1]})
            self.emit("progress", 20 * step)
            if self.should_stop():
                break

    def shutdown(self) -> None:
        """Go to 0 V, also after an error or an abort."""
        self.bench.close()


if __name__ == "__main__":
    worker = Worker(Results(Friction(), "friction.csv"))
    worker.start()
    worker.join(timeout=60)
