// Core from the command line, for the tests: a question a line, the answer as a line of JSON.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.Linq;
using System.Net;
using System.Text;
using System.Threading.Tasks;
using Pcmrs;

public static class Probe
{
    private static readonly IPAddress Daemon = IPAddress.Loopback;
    private static CommandLink commands;
    private static Planner planner;
    private static StreamReceiver receiver;
    private static PoseStreams poses;
    private static StateLink state;

    /// <summary>Without words what needs no daemon; else its command port, and the peer and key file to sign with; answers are signed, too.</summary>
    public static void Main(string[] words)
    {
        if (words.Length > 0)
        {
            Signer signer = words.Length == 1 ? null : new Signer(words[1], Signer.ReadKey(words[2]), true);
            commands = new CommandLink(new IPEndPoint(Daemon, Port(words[0])), signer);
            planner = new Planner(commands);
        }
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            Console.WriteLine(Answer(line));
        }
        poses?.Dispose();
        state?.Dispose();
        receiver?.Dispose();
        commands?.Dispose();
    }

    private static string Answer(string line)
    {
        int space = line.IndexOf(' ');
        string question = space < 0 ? line : line.Substring(0, space);
        string rest = space < 0 ? "" : line.Substring(space + 1);
        try
        {
            return Ask(question, rest).GetAwaiter().GetResult();
        }
        catch (Exception error)
        {
            var refused = error as CommandRefusedException;
            return "{\"error\": " + Quoted(error.GetType().Name) + ", \"reason\": " + Quoted(refused?.Verdict.Reason)
                + "}";
        }
    }

    private static async Task<string> Ask(string question, string rest)
    {
        switch (question)
        {
            case "mirror_point":
                return Json(Numbers(Handedness.Mirror(Point(Read(rest), 0))));
            case "mirror_pose":
                return Json(Numbers(Handedness.Mirror(Pose(Read(rest), 0))));
            case "mirror_matrix":
                return Json(Numbers(Handedness.Mirror(Matrix(Read(rest)))));
            case "compose":
                return Json(Numbers(Pose(Read(rest), 0) * Pose(Read(rest), 7)));
            case "inverse":
                return Json(Numbers(Pose(Read(rest), 0).Inverse));
            case "apply":
                return Json(Numbers(Pose(Read(rest), 0) * Point(Read(rest), 7)));
            case "to_matrix":
                return Json(Numbers(Pose(Read(rest), 0).ToMatrix()));
            case "from_matrix":
                return Json(Numbers(RigidPose.FromMatrix(Matrix(Read(rest)))));
            case "message":
                byte[] datagram = Encoding.ASCII.GetBytes(rest);
                StreamMessage message = StreamMessage.Parse(datagram, datagram.Length);
                return Json(message.Points.Length == 0 ? Numbers(message.Pose) : message.Points.SelectMany(Numbers),
                    message.Kind.ToString());
            case "verdict":
                string id;
                Verdict verdict = Verdict.Parse(rest, out id);
                return Json(verdict.Results,
                    string.Join(" ", id, verdict.Decision, verdict.Branch, verdict.State, verdict.Reason));
            case "state_of":
                return State(CellState.Parse(rest));

            case "plan_landmarks":
                double[] n = Read(rest);
                await planner.PlanLandmarksAsync(
                    Enumerable.Range(0, n.Length / 3).Select(index => Point(n, 3 * index)).ToArray());
                return Json();
            case "plan_pose":
                await planner.PlanPoseAsync(Pose(Read(rest), 0));
                return Json();
            case "digitize_all":
                await planner.DigitizeAllAsync();
                return Json();
            case "register":
                return Json(new[] { await planner.RegisterAsync() });
            case "connect":
                await planner.ConnectAsync();
                return Json();
            case "approach":
                await planner.ApproachAsync();
                return Json();
            case "home":
                await planner.HomeAsync();
                return Json();
            case "reinitiate":
                await planner.ReinitiateAsync();
                return Json();
            case "begin_home":
                begun = planner.HomeAsync();
                return Json();
            case "end":
                await begun;
                return Json();
            case "confirm":
                MeasuredPlacement placed = await planner.ConfirmAsync();
                return Json(Numbers(placed.Pose).Concat(new[] { placed.TranslationErrorMm, placed.RotationErrorDeg }));
            case "move":
                await planner.NudgeAsync(Point(Read(rest), 0));
                return Json();
            case "turn":
                await planner.NudgeAsync(Pose(Read("0 0 0 " + rest), 0).Rotation);
                return Json();
            case "joints":
                return Json(await planner.JointsAsync());
            case "flange":
                return Json(Numbers(await planner.FlangeAsync()));
            case "stop":
                await planner.StopAsync();
                return Json();
            case "tool_points":
                planner.SendToolPoints(Point(Read(rest), 0), Point(Read(rest), 3));
                return Json();
            case "raw":
                string[] parts = rest.Split(' ');
                Verdict plain = await commands.SendAsync(parts[0], TimeSpan.FromSeconds(double.Parse(parts[1],
                    CultureInfo.InvariantCulture)), parts.Skip(2).ToArray<object>());
                return Json(plain.Results, plain.Decision + " " + plain.Reason);

            case "receive":
                receiver = new StreamReceiver(Daemon, Port(rest));
                return Json(new double[] { receiver.Port });
            case "received":
                return Json(new double[] { receiver.Received, receiver.Refused });
            case "newest":
                StreamMessage newest = receiver.Newest((StreamKind)Enum.Parse(typeof(StreamKind), rest), 1.0);
                return newest == null ? Json() : Json(
                    newest.Points.Length == 0 ? Numbers(newest.Pose) : newest.Points.SelectMany(Numbers));
            case "keep_streams":
                poses = new PoseStreams(receiver, planner);
                return Json();
            case "pose":
                RigidPose pose;
                bool known = poses.TryGet((StreamKind)Enum.Parse(typeof(StreamKind), rest), out pose);
                return known ? Json(Numbers(pose)) : Json();
            case "hear_state":
                state = new StateLink(new IPEndPoint(Daemon, Port(rest)));
                return Json();
            case "state":
                return state.State == null ? Json() : State(state.State);
            case "tracked":
                return state.TryGetPose(rest, 0.5, out pose) ? Json(Numbers(pose)) : Json();
            default:
                throw new ArgumentException(question);
        }
    }

    private static Task begun;

    private static int Port(string word) => int.Parse(word, CultureInfo.InvariantCulture);

    private static double[] Read(string text) =>
        text.Split(' ').Select(word => double.Parse(word, CultureInfo.InvariantCulture)).ToArray();

    private static Vec3 Point(double[] n, int first) => new Vec3(n[first], n[first + 1], n[first + 2]);

    private static RigidPose Pose(double[] n, int first) =>
        new RigidPose(Point(n, first), new Quat(n[first + 3], n[first + 4], n[first + 5], n[first + 6]));

    private static double[,] Matrix(double[] n)
    {
        var matrix = new double[4, 4];
        for (int index = 0; index < 16; index++)
        {
            matrix[index / 4, index % 4] = n[index];
        }
        return matrix;
    }

    private static IEnumerable<double> Numbers(Vec3 v) => new[] { v.X, v.Y, v.Z };

    private static IEnumerable<double> Numbers(RigidPose pose) =>
        Numbers(pose.Position).Concat(new[] { pose.Rotation.X, pose.Rotation.Y, pose.Rotation.Z, pose.Rotation.W });

    private static IEnumerable<double> Numbers(double[,] matrix) => matrix.Cast<double>();

    private static string State(CellState read)
    {
        IEnumerable<string> branches = read.Branches.Select(pair => Quoted(pair.Key) + ": " + Quoted(pair.Value));
        IEnumerable<string> flags = read.Flags.Select(pair => Quoted(pair.Key) + ": " + Text(pair.Value));
        return "{\"sequence\": " + read.Sequence + ", \"latched\": " + Text(read.Latched)
            + ", \"branches\": {" + string.Join(", ", branches) + "}, \"flags\": {" + string.Join(", ", flags)
            + "}, \"running\": [" + string.Join(", ", read.Running.Select(Quoted)) + "], \"plan\": " + Quoted(read.Plan)
            + ", \"registration\": " + Quoted(read.Registration) + "}";
    }

    private static string Json(IEnumerable<double> numbers = null, string text = null) =>
        "{\"numbers\": " + (numbers == null ? "null" : "[" + string.Join(", ", numbers.Select(
            number => number.ToString("R", CultureInfo.InvariantCulture))) + "]") + ", \"text\": " + Quoted(text) + "}";

    private static string Text(bool value) => value ? "true" : "false";

    private static string Quoted(string text) =>
        text == null ? "null" : "\"" + text.Replace("\\", "\\\\").Replace("\"", "\\\"") + "\"";
}
