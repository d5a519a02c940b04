/* Starts lcm-spy as scripts/spy does and checks its windows: channels are listed with their types, and a double click opens a
   window with the decoded timing. See test_spy.sh. */
import java.awt.Component;
import java.awt.Container;
import java.awt.Frame;
import java.awt.Rectangle;
import java.awt.event.MouseEvent;
import java.lang.reflect.Field;
import java.util.Arrays;
import java.util.function.Supplier;
import javax.swing.JTable;
import javax.swing.SwingUtilities;

public class CheckSpy {
    static final String[] CHANNELS = {"TROCAR_POSE", "TROCAR_WRENCH", "TROCAR_TIMING", "TROCAR_STATUS", "TROCAR_CONTACTS",
        "TROCAR_DEFORMATION"};

    /* Waits up to 20 s until the supplier returns a result. */
    static <T> T await(String what, Supplier<T> supplier) throws Exception {
        for (int i = 0; i < 200; i++) {
            Object[] result = new Object[1];
            SwingUtilities.invokeAndWait(() -> result[0] = supplier.get());
            @SuppressWarnings("unchecked") T found = (T) result[0];
            if (found != null) return found;
            Thread.sleep(100);
        }
        throw new Exception("missing after 20 s: " + what);
    }

    static <T> T find(Component root, Class<T> type) {
        if (type.isInstance(root)) return type.cast(root);
        if (!(root instanceof Container)) return null;
        for (Component child : ((Container) root).getComponents()) {
            T found = find(child, type);
            if (found != null) return found;
        }
        return null;
    }

    static <T> T findInFrames(String title, Class<T> type) {
        for (Frame frame : Frame.getFrames())
            if (frame.isShowing() && frame.getTitle().contains(title)) {
                T found = find(frame, type);
                if (found != null) return found;
            }
        return null;
    }

    /* The row of a channel whose type is known, or null. */
    static Integer row(JTable table, String channel) {
        for (int i = 0; i < table.getRowCount(); i++)
            if (channel.equals(String.valueOf(table.getValueAt(i, 0))) && String.valueOf(table.getValueAt(i, 1)).endsWith("_t"))
                return i;
        return null;
    }

    static void doubleClick(JTable table, int row) {
        Rectangle cell = table.getCellRect(row, 0, true);
        for (int id : new int[] {MouseEvent.MOUSE_PRESSED, MouseEvent.MOUSE_RELEASED, MouseEvent.MOUSE_CLICKED})
            table.dispatchEvent(new MouseEvent(table, id, System.currentTimeMillis(), 0, cell.x + 2, cell.y + 2, 2, false, MouseEvent.BUTTON1));
    }

    /* The decoded message in a channel's window. */
    static Object shown(lcm.spy.ObjectPanel panel) {
        try {
            Field message = lcm.spy.ObjectPanel.class.getDeclaredField("o");
            message.setAccessible(true);
            return message.get(panel);
        } catch (ReflectiveOperationException fault) {
            throw new IllegalStateException(fault);
        }
    }

    static boolean ordered(double... values) {
        for (int i = 1; i < values.length; i++)
            if (!(values[i - 1] <= values[i])) return false;
        return true;
    }

    static void expect(boolean holds, String what) throws Exception {
        if (!holds) throw new Exception("wrong fields in the timing: " + what);
    }

    /* Checks every field for plausibility. */
    static void expectTiming(trocar.loop_timing_t t) throws Exception {
        expect(t.rate_hz == 1000 && t.ticks > 0, "rate " + t.rate_hz + ", ticks " + t.ticks);
        expect(t.server > 0, "server " + t.server);
        expect(Math.abs(t.utime * 1e-3 - System.currentTimeMillis()) < 60e3, "utime " + t.utime);
        expect(t.lateness_p50 > 0 && ordered(t.lateness_p50, t.lateness_p99, t.lateness_max, t.lateness_max_total), "lateness");
        expect(t.compute_p50 > 0 && ordered(t.compute_p50, t.compute_p99, t.compute_max, t.compute_max_total), "compute");
        expect(t.round_trip_p50 > 0 && ordered(t.round_trip_p50, t.round_trip_p99, t.round_trip_max, 60), "round trip");
        expect(ordered(0, t.worker_latency_p50, t.worker_latency_p99, t.worker_latency_max, 60) && t.snapshot_age >= 0, "worker");
        int lateness = Arrays.stream(t.lateness_bins).sum(), compute = Arrays.stream(t.compute_bins).sum();
        expect(compute > 0 && Math.abs(lateness - compute) <= 1, "bins: " + lateness + " and " + compute);
        double stages = Arrays.stream(t.stage_mean).sum();
        expect(stages > 0 && stages <= t.compute_max && t.stage_max.length == trocar.loop_timing_t.STAGE_OUTPUT + 1, "stages: " + stages);
        expect(ordered(stages, Arrays.stream(t.stage_max).sum()), "longest stages");
        for (long count : new long[] {t.misses, t.allocations, t.minor_faults, t.major_faults, t.context_switches, t.wrenches_dropped, t.contacts})
            expect(count >= 0 && count < 1000000, "a counter: " + count);
    }

    public static void main(String[] arguments) {
        try {
            lcm.spy.Spy.main(arguments);
            JTable table = await("the window", () -> findInFrames("", JTable.class));
            for (String channel : CHANNELS) await(channel + " in the list, with its type", () -> row(table, channel));
            int timing = await("TROCAR_TIMING", () -> row(table, "TROCAR_TIMING"));
            SwingUtilities.invokeAndWait(() -> doubleClick(table, timing));
            lcm.spy.ObjectPanel fields = await("the window of TROCAR_TIMING", () -> findInFrames("TROCAR_TIMING", lcm.spy.ObjectPanel.class));
            expectTiming((trocar.loop_timing_t) await("a timing in its window", () -> shown(fields)));
            System.out.println("passed");
            Runtime.getRuntime().halt(0);
        } catch (Throwable fault) {
            fault.printStackTrace();
            JTable table = findInFrames("", JTable.class);
            for (int i = 0; table != null && i < table.getRowCount(); i++)
                System.err.println(table.getValueAt(i, 0) + " | " + table.getValueAt(i, 1));
            Runtime.getRuntime().halt(1);
        }
    }
}
