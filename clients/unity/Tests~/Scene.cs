// The components of Runtime/Unity on the stub of UnityEngine, as Unity drives them: a frame every 20 ms, a line for each.
using System;
using System.Globalization;
using System.Reflection;
using System.Threading;
using Pcmrs.Unity;
using UnityEngine;

public static class Scene
{
    /// <summary>Ports of commands, streams and state, and the number of frames.</summary>
    public static void Main(string[] words)
    {
        int[] numbers = Array.ConvertAll(words, word => int.Parse(word, CultureInfo.InvariantCulture));
        var cell = new PcmrsCell { commandPort = numbers[0], streamPort = numbers[1], statePort = numbers[2] };
        var tool = new PcmrsPose { cell = cell, source = PcmrsPose.Source.Tool, visual = new GameObject() };
        var target = new PcmrsPose { cell = cell, source = PcmrsPose.Source.Target, visual = new GameObject() };
        Call(cell, "OnEnable");
        for (int frame = 0; frame < numbers[3]; frame++)
        {
            Call(cell, "Update");
            Call(tool, "Update");
            Call(target, "Update");
            Console.WriteLine("{\"tool\": " + Shown(tool) + ", \"target\": " + Shown(target) + ", \"registration\": "
                + (cell.State == null ? "null" : "\"" + cell.State.Branches["registration"] + "\"") + "}");
            Thread.Sleep(20);
        }
        Call(cell, "OnDisable");
    }

    private static void Call(object component, string message) =>
        component.GetType().GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(component, null);

    private static string Shown(PcmrsPose pose)
    {
        Vector3 p = pose.transform.localPosition;
        Quaternion q = pose.transform.localRotation;
        return !pose.visual.activeSelf ? "null" : string.Format(
            CultureInfo.InvariantCulture, "[{0:R}, {1:R}, {2:R}, {3:R}, {4:R}, {5:R}, {6:R}]",
            p.x, p.y, p.z, q.x, q.y, q.z, q.w);
    }
}
